"""Files of other programs, read without running anything that is in them: PyTorch archives, pickles, faiss indexes."""
