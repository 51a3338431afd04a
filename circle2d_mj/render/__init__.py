"""Pictures: canvas, figures, and off-screen OpenGL."""
