"""One file a log format: raw log to batches of rows."""
