"""The YAML spec: its shape, its units and its line-numbered errors. Scenario and stages are still unresolved here."""
