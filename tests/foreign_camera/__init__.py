"""What tests alone need of the foreign camera: its first trials, and a folder as laboratories leave it."""
