"""Studies: what each varies, measures and draws."""
