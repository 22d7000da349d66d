"""Recorded walks through real homes: the Active Vision Dataset, and scans of the same format made here."""
