"""Fitting a truck to measured runs."""
