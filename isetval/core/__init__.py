"""The types that everything else lives in; checks only, no analysis and no physics."""
