"""Model deviation estimators: networks that say how far a fast model will be from the trusted one."""
