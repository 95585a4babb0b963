"""Geometry of meshes: surfaces, kernels, warps, sparse systems and nearest points."""
