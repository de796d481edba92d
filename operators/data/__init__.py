"""What Blender stores of a splat, of cameras and of images, as arrays and back. Only here is numpy used."""
