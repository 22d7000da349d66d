"""Recognisers: what others train on the same views to name objects, the other rows of the paper's Table 2."""
