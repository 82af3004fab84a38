defmodule Aerie.Api.Rest.Operations.Gateway do
  @moduledoc """
  What can be asked of the gateway itself, each declared in one file (`Aerie.Control.Operations.Operation`). It is asked
  over REST only.
  """

  alias Aerie.Api.Rest.Operations.{AddClient, AddLink, ChangeLog, ChangeRules, Record, SaveRecording, Sign}
  alias Aerie.Control.Operations.Operation

  @doc "All of them."
  @spec all() :: [Operation.t(), ...]
  def all do
    for module <- [AddLink, AddClient, ChangeRules, ChangeLog, Record, SaveRecording, Sign],
        do: %{module.operation() | module: module}
  end
end
