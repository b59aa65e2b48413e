"""What `import lidar_emu` offers beside scenarios and simulation: planning, ground, campaigns, spectra, embedding."""
