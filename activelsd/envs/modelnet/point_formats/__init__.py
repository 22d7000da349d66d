"""Parsers of files of points, a module for each format: each gives a table of numbers."""
