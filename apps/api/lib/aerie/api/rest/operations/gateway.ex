defmodule Aerie.Api.Rest.Operations.Gateway do
  @moduledoc """
  What can be asked of the gateway itself, each declared in one file (`Aerie.Control.Operations.Operation`). It is asked
  over REST and from the command line.
  """

  alias Aerie.Api.Rest.Operations.{
    Clients,
    Commands,
    Events,
    Links,
    Log,
    Plans,
    Recordings,
    Rules,
    Signing,
    Tracks
  }

  alias Aerie.Control.Operations.Operation

  @doc "All of them."
  @spec all() :: [Operation.t(), ...]
  def all do
    for module <-
          [
            Links.List,
            Links.Add,
            Links.Remove,
            Clients.List,
            Clients.Add,
            Clients.Remove,
            Rules.List,
            Rules.Change,
            Rules.Reset,
            Log.Get,
            Log.Change,
            Recordings.Set,
            Recordings.Save,
            Signing.List,
            Signing.Change,
            Events.List,
            Plans.Store,
            Tracks.Get
          ] ++ Commands.modules(),
        do: %{module.operation() | module: module}
  end
end
