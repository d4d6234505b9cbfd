"""Keys of epochs, to whom they are sealed, and embeddings sealed under them."""
