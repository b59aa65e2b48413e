"""Triangle meshes: reading of files, and casting of rays onto triangles."""
