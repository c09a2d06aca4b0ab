"""Studies, one module each: settings, measures, figures and tables."""
