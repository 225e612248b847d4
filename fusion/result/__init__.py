"""What a fused flight is: its tables, summary and conventions, as values and as files."""
