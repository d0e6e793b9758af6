"""From heights to a closed mesh that is fit for fabrication."""
