"""Fine-tuning: one loop, two engines. See loop.py."""
