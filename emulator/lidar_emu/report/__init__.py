"""What a run leaves behind for people: tables, point clouds and plots."""
