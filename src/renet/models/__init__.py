"""Networks: embeddings, encoders, estimators, HIM, autoencoder, actor and critics."""
