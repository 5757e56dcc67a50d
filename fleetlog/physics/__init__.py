"""Forces and powers as terms of one sum, used alike by simulate, analyze energy, calibrate and diagnose."""
