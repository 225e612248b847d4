"""What the benchmarks share: pictures whose truth is known, ways to spoil them, scores and tables, other methods."""
