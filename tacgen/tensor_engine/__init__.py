"""Many scenes at once in PyTorch: meshes of one pattern, factorised and solved as batches."""
