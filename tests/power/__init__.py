"""Proof that the gate detects faults, and its measured false-alarm rate."""
