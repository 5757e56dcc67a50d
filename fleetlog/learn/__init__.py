"""Sites from traces: roads, places and zones that a recording alone shows, each with its evidence."""
