"""Many motions at once: what varies, lanes that advance together, chunks that can be resumed."""
