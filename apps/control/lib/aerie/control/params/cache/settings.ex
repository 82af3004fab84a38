defmodule Aerie.Control.Params.Cache.Settings do
  @moduledoc "The settings of the parameter lists that the gateway stores."
  use Aerie.Base.Settings

  section "params", "Parameters of vehicles (docs/transfers.md)."

  setting :dir, :path, "Folder for the lists that were read, for its owner only.", default: "var/params"

  setting :max_lists,
          {:integer, 1, 100_000},
          "Lists of vehicles that are kept; the oldest one makes room for another one.",
          default: 1_000
end
