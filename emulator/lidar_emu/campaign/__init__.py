"""Many runs of one scenario: drawn, flown by many processes, kept, and told about."""
