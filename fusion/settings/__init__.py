"""Settings from TOML files, checked: unknown keys and wrong units are refused with a remedy."""
