defmodule Aerie.Control.Commands.Ownership do
  @moduledoc """
  Which of several gateways holds a vehicle, and where gateways claim the ids of commands.
  `Aerie.Fleet.Remote.Claims` is one; `Aerie.Gateway` plugs it in. Without one a gateway is alone.
  """

  alias Aerie.Vehicle.Command.Result
  alias Aerie.Control.Commands.Gateways.Sending
  alias Aerie.Base.Names

  @doc "The gateway that holds a vehicle."
  @callback holder(Names.gateway(), vehicle :: String.t()) :: Sending.holder()

  @doc """
  Claims a command's id where all gateways see it, within a time. `{:taken, claim}`: another gateway has claimed it, and
  which result it had, if that is known.
  """
  @callback claim(Names.gateway(), vehicle :: String.t(), id :: String.t(), timeout_ms :: pos_integer()) ::
              :ok | {:taken, %{by: String.t(), result: Result.t() | nil}} | {:error, String.t()}

  @doc "Tells the other gateways what became of a command that this one claimed. Waits for nothing."
  @callback done(Names.gateway(), vehicle :: String.t(), Result.t()) :: :ok
end
