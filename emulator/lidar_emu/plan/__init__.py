"""The plan: what a run computes, what it leaves out with which error bound, and the errors to be expected."""
