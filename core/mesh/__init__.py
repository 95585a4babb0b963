"""Meshes and the space round them, whatever they show: surfaces, kernels, warps, sparse systems, nearest points."""
