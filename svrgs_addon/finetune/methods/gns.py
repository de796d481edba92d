"""GNS (arXiv 2511.16980): its natural selection, a pressure on all opacities (opacity_pressure.py). Densification is that of 3DGS."""

from .opacity_pressure import PressureMethod

METHODS = (PressureMethod("gns", "lowers all opacities with the same pressure and removes the Gaussians that fade", 12, "GNS", share=0.25),)
