"""One page about one dataset, or about two side by side; and the house of all pages."""
