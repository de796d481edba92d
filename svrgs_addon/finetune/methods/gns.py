"""GNS (arXiv 2511.16980): its natural selection by a pressure on all opacities (opacity_pressure.py). Growth is that of 3DGS."""

from .opacity_pressure import Pressed

METHODS = (Pressed("gns", "GNS: presses all opacities down alike until few enough Gaussians withstand", 12, share=0.25),)
