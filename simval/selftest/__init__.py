"""Proof that the gate catches faults, and how seldom it cries wolf."""
