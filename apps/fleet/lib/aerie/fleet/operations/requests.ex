defmodule Aerie.Fleet.Operations.Requests do
  @moduledoc """
  What NATS and REST can ask about operations on many vehicles (`Aerie.Control.Operations.Operation`). `docs/fleet.md`
  describes them for users.
  """

  use Aerie.Control.Operations.Table, [
    Aerie.Fleet.Operations.Requests.List,
    Aerie.Fleet.Operations.Requests.Begin,
    Aerie.Fleet.Operations.Requests.Get,
    Aerie.Fleet.Operations.Requests.Pause,
    Aerie.Fleet.Operations.Requests.Continue,
    Aerie.Fleet.Operations.Requests.Stop,
    Aerie.Fleet.Operations.Requests.Abort,
    Aerie.Fleet.Operations.Requests.AbortAll,
    Aerie.Fleet.Operations.Requests.Readiness
  ]
end
