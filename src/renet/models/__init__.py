"""What is learned: embeddings, encoders, estimators, HIM, autoencoder, actor and critics."""
