"""Camera pictures of many faces at once on a GPU, by PyTorch and Triton: what optics computes, sample by sample."""
