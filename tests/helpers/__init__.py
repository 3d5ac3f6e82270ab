"""Small things that many tests stand on: meshes, sensors, recipes, bundles, scenes for engines, photographs."""
