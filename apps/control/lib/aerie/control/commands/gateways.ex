defmodule Aerie.Control.Commands.Gateways do
  @moduledoc """
  Passes commands on to the gateway that hears the vehicle, after ledger, rates, policy and audit log of this gateway
  have let them through; those of the other gateway then decide as well. `Aerie.Fleet.Remote` implements it;
  `Aerie.Gateway` plugs it in.

  A command that came from another gateway, over NATS, is never passed on.
  """

  alias Aerie.Base.{Names, Store}
  alias Aerie.Vehicle.Command
  alias Aerie.Vehicle.Command.Result
  alias Aerie.Control.Commands.Pipeline.Request

  @doc """
  Passes the command to the gateway of the vehicle's snapshot (`:via`), and waits for its result. `progress` is called
  with that gateway's progress.
  """
  @callback submit(
              Names.gateway(),
              snapshot :: map(),
              Command.t(),
              Request.t(),
              progress :: (map() -> term())
            ) ::
              Result.t()

  @typedoc "What is asked besides commands: area, operation and body, as in `docs/transfers.md`."
  @type request :: {area :: String.t(), operation :: String.t(), body :: %{String.t() => term()}}

  @doc """
  Asks the gateway of the vehicle's snapshot for something that is not a command, in the name of `who`, and waits at
  most a little longer than `timeout_ms`; nil: as long as that gateway reports progress. Gives what it answered beside
  its result, or the result that says why there is nothing.
  """
  @callback transfer(
              Names.gateway(),
              snapshot :: map(),
              id :: String.t(),
              request(),
              who :: String.t(),
              timeout_ms :: pos_integer() | nil,
              progress :: (map() -> term())
            ) :: {:ok, %{String.t() => term()}} | {:error, Result.t()}

  @doc "The snapshot of a vehicle that this gateway or another one hears; nil if it is not known."
  @callback vehicle(Names.gateway(), id :: String.t()) :: map() | nil

  @doc "The module that reaches vehicles of other gateways; nil if there is none."
  @spec module(Names.gateway()) :: module() | nil
  def module(gateway),
    do: with(%{remote_gateway: module} <- Names.value(gateway, :command_server), do: module)

  @doc "The snapshot of a vehicle, wherever it is heard; nil if it is not known."
  @spec vehicle(Names.gateway(), id :: String.t()) :: map() | nil
  def vehicle(gateway, id) do
    case module(gateway) do
      nil -> Store.vehicle(gateway, id)
      module -> module.vehicle(gateway, id)
    end
  end

  @doc """
  A vehicle's snapshot as that of one which is reached by another gateway (`:via`), although this one hears it
  (`:heard_here?`).
  """
  @spec reached_by(snapshot :: map(), gateway :: String.t()) :: map()
  def reached_by(snapshot, name), do: Map.merge(snapshot, %{via: name, heard_here?: true})

  @doc "Why a gateway does not do something to a vehicle that it reaches by another one."
  @spec only(via :: String.t()) :: String.t()
  def only(via),
    do: "not available for a remote vehicle: it is heard by the gateway #{via}; ask that one (docs/fleet.md)"

  @doc "Asks the other gateway to cancel a command."
  @callback cancel(Names.gateway(), snapshot :: map(), id :: String.t()) :: :ok | {:error, String.t()}
end
