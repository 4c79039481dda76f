"""The benchmark: frozen suites, one file for each method, a leaderboard as one page."""
