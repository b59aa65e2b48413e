"""Clock, processes, ring and pace: from finished packets with due times to bytes on a port."""
