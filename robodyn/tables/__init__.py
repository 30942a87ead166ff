"""Records, CSV in and out, and files that a failed run leaves as they were."""
