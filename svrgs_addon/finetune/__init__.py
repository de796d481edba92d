"""Fine-tuning on photographs: one loop (loop.py), two engines (engine.py, torch_engine.py), methods/."""
