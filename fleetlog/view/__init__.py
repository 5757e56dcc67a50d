"""The only code that draws: Rerun recordings and PNG pictures."""
