"""Camera pictures of many faces at once on a GPU, by the kernels of optics: every sample is computed."""
