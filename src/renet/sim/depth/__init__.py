"""The depth camera: rays, images and their errors."""
