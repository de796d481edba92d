"""Fine-tuning of a scene on photographs: one loop (loop.py), two engines (engine.py, torch_engine.py) and the
methods (methods/)."""
