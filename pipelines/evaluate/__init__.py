"""Measurements on held-out data: raw results, then the tables and figures that read them."""
