defmodule Aerie.Commands.Elsewhere do
  @moduledoc """
  The way to vehicles that another gateway hears. The door passes a command on by it when ledger, rates, policy and audit log of this
  gateway have let it through; those of the other gateway then decide, too. `Aerie.Remote` is one; `Aerie.Gateway` plugs it in.

  A command that came from another gateway, by NATS, is never passed on.
  """

  alias Aerie.{Command, Names}
  alias Aerie.Command.Result
  alias Aerie.Commands.Desk

  @doc """
  Gives the command to the gateway of the vehicle's snapshot (`:via`), and waits for its result. `progress` is called with what the other
  gateway tells meanwhile.
  """
  @callback submit(
              Names.gateway(),
              snapshot :: map(),
              Command.t(),
              Desk.request(),
              progress :: (map() -> term())
            ) ::
              Result.t()

  @doc "Asks the other gateway to let a command cease."
  @callback cancel(Names.gateway(), snapshot :: map(), id :: String.t()) :: :ok | {:error, String.t()}
end
