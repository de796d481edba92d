"""The definition of truth: float64, dense, differentiable by autograd, readable beside the paper."""
