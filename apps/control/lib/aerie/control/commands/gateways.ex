defmodule Aerie.Control.Commands.Gateways do
  @moduledoc """
  The other gateways of a fleet: which of them holds a vehicle, and how a command gets to it. `Aerie.Fleet.Remote`
  implements it; `Aerie.Gateway` plugs it in. Without it a gateway is alone.

  A command is passed on after ledger, rates, policy and audit log of this gateway have let it through; those of the
  other gateway then decide as well. A command that came from another gateway, over NATS, is never passed on.
  """

  alias Aerie.Base.{Names, Store}
  alias Aerie.Vehicle.Command
  alias Aerie.Vehicle.Command.Result
  alias Aerie.Control.Commands.Gateways.Sending
  alias Aerie.Control.Commands.Pipeline.Request

  @typedoc "What is asked besides commands: area, operation and body, as in `docs/transfers.md`."
  @type request :: {area :: String.t(), operation :: String.t(), body :: %{String.t() => term()}}

  @doc "The snapshot of a vehicle that this gateway or another one hears; nil if it is not known."
  @callback vehicle(Names.gateway(), id :: String.t()) :: map() | nil

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

  @doc "Asks the gateway of the vehicle's snapshot to cancel a command."
  @callback cancel(Names.gateway(), snapshot :: map(), id :: String.t()) :: :ok | {:error, String.t()}

  @doc "The module that knows the other gateways; nil if this one is alone."
  @spec module(Names.gateway()) :: module() | nil
  def module(gateway), do: with(%{gateways: module} <- Names.value(gateway, :command_server), do: module)

  @doc "The snapshot of a vehicle, wherever it is heard; nil if it is not known."
  @spec vehicle(Names.gateway(), id :: String.t()) :: map() | nil
  def vehicle(gateway, id) do
    case module(gateway) do
      nil -> Store.vehicle(gateway, id)
      module -> module.vehicle(gateway, id)
    end
  end

  @doc "A vehicle's snapshot, as reached by the gateway that holds it (`reached_by/2`)."
  @spec reached(Names.gateway(), snapshot :: map()) :: map()
  def reached(_gateway, %{via: via} = snapshot) when via != nil, do: snapshot

  def reached(gateway, snapshot) do
    with module when module != nil <- module(gateway),
         {:other, name} <- module.holder(gateway, snapshot.id) do
      reached_by(snapshot, name)
    else
      _alone_mine_or_unknown -> snapshot
    end
  end

  @doc """
  A vehicle's snapshot as that of one which is reached by another gateway (`:via`), although this one hears it
  (`:heard_here?`).
  """
  @spec reached_by(Aerie.Vehicle.Snapshot.t(), gateway :: String.t()) :: Aerie.Vehicle.Snapshot.t()
  def reached_by(snapshot, name), do: %{snapshot | via: name, heard_here?: true}
end
