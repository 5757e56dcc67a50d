"""One file a question: dataset to result."""
