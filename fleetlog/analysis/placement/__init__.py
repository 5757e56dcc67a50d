"""Ranking road vertices by traffic and choosing sites among them."""
