"""What it runs on: the native CPU engine, the depth camera and terrain scans."""
