"""Commands for a first hour: does it work here, what does it do, what to try."""
