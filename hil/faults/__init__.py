"""Injection of faults into line, servo, host and processes, checked against a fault table."""
