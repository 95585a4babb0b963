"""Geometry of any mesh: surfaces, kernels, warps, sparse systems, nearest points."""
