"""Meshes: reading them, and the casting of rays onto their triangles."""
