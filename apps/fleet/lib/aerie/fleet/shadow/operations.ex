defmodule Aerie.Fleet.Shadow.Operations do
  @moduledoc """
  What NATS and REST can ask of the shadow (`Aerie.Control.Operations.Operation`). `docs/shadow.md` describes it for
  users.
  """

  use Aerie.Control.Operations.Table, [
    Aerie.Fleet.Shadow.Operations.Get,
    Aerie.Fleet.Shadow.Operations.Delta,
    Aerie.Fleet.Shadow.Operations.Update,
    Aerie.Fleet.Shadow.Operations.Delete
  ]
end
