"""Pictures: viewports, the render engine, comparison, the spatial mask, the manual."""
