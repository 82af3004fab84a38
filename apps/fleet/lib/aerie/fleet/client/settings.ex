defmodule Aerie.Fleet.Client.Settings do
  @moduledoc "Unix sockets for programs on this machine."
  use Aerie.Base.Settings

  section "sockets",
          "Unix sockets for programs on this machine: state.sock (JSON lines) and mavlink.sock (frames)."

  setting :enabled, :boolean, "Open them.", default: true

  setting :dir,
          :path,
          "Folder. Left out: $XDG_RUNTIME_DIR/aerie, /run/aerie, or var/run. Its permissions say who may use them.",
          example: ~S("/run/aerie")

  setting :state_hz, {:number, 0.1, 50}, "How often state.sock tells every vehicle's state.", default: 10.0

  setting :sign,
          :boolean,
          "What comes by mavlink.sock unsigned is believed, and signed for vehicles that ask for it.",
          default: false

  setting :max_clients, {:integer, 1, 10_000}, "Clients of each socket; further ones are refused.",
    default: 32
end
