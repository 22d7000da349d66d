"""Parsers of mesh files, one module for each format: bytes in, a checked count of polygons out."""
