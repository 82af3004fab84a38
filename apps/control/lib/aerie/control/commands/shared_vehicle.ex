defmodule Aerie.Control.Commands.SharedVehicle do
  @moduledoc """
  The steps of `Aerie.Control.Commands.Pipeline` that concern other gateways which hear the same vehicle: asks what `Aerie.Control.Commands.OwnershipCheck` wants to
  know, of `Aerie.Control.Commands.Ownership`, and does what it decides.
  """

  alias Aerie.Vehicle.Command.Result
  alias Aerie.Control.Commands.OwnershipCheck
  alias Aerie.Base.Names

  # For a claim that nobody waits for.
  @alone_ms 500

  # Why a gateway that was said to have the lease gave no command to the vehicle.
  @unheld ~w(unreachable holder claim unavailable vehicle)

  @type ctx :: map()
  @type stop :: {:stop, Result.status(), rule :: atom(), reason :: String.t()}

  @doc """
  Finds out who holds the vehicle. If another gateway does, the snapshot is that of a vehicle which is reached by that one (`:via`); such a
  command, and one for a vehicle that is not heard here, needs no claim of this gateway (nil).
  """
  @spec evaluate(ctx(), snapshot :: map()) :: {:ok, map(), OwnershipCheck.t() | nil} | stop()
  def evaluate(%{holder: nil}, snapshot), do: {:ok, snapshot, nil}
  def evaluate(_way, %{via: via} = snapshot) when via != nil, do: {:ok, snapshot, nil}

  def evaluate(%{request: request, patience: patience} = ctx, snapshot),
    do:
      evaluate(
        ctx,
        snapshot,
        OwnershipCheck.new(now() + patience, request.via == "nats", ctx.facts.ends_flight?)
      )

  defp evaluate(ctx, snapshot, holding) do
    case OwnershipCheck.handle(holding, {:holder, holder(ctx), now()}) do
      {holding, :go_on} -> {:ok, snapshot, holding}
      {_over, {:pass_on, name}} -> pass_on(ctx, snapshot, name)
      {_over, {:refuse, rule, why}} -> refuse(rule, why)
      {holding, {:again, ms}} -> again(ms, ctx, snapshot, holding)
    end
  end

  defp again(ms, ctx, snapshot, holding) do
    receive do
    after
      ms -> evaluate(ctx, snapshot, holding)
    end
  end

  defp pass_on(%{remote_gateway: nil, facts: %{ends_flight?: true}}, snapshot, _name),
    do: {:ok, snapshot, nil}

  defp pass_on(%{remote_gateway: nil}, _snapshot, name),
    do: refuse(:holder, "the gateway #{name} holds the vehicle")

  defp pass_on(%{holder: holder, gateway: gateway}, snapshot, name),
    do: {:ok, by(holder, gateway, snapshot, {:other, name}), nil}

  @doc """
  A vehicle's snapshot as that of one which is reached by another gateway (`:via`), if another one holds it. `:holds?` says whether it still
  does.
  """
  @spec by(module() | nil, Names.gateway(), snapshot :: map()) :: map()
  def by(nil, _gateway, snapshot), do: snapshot
  def by(_holder, _gateway, %{via: via} = snapshot) when via != nil, do: snapshot
  def by(holder, gateway, snapshot), do: by(holder, gateway, snapshot, holder.holder(gateway, snapshot.id))

  defp by(holder, gateway, %{id: id} = snapshot, {:other, name}) do
    holds? = fn -> match?({:other, ^name}, holder.holder(gateway, id)) end
    Map.merge(snapshot, %{via: name, holds?: holds?})
  end

  defp by(_holder, _gateway, snapshot, _mine_or_unknown), do: snapshot

  @doc """
  Whether this gateway gives a command itself after it was passed on in vain: the vehicle is heard here, the
  command holds it or brings it down, and the gateway that has the lease did not answer or does not have it any more.
  """
  @spec again?(ctx(), snapshot :: map(), Result.t()) :: boolean()
  def again?(%{facts: %{ends_flight?: true}}, %{holds?: _heard_here}, result),
    do: result.status == :unknown or result.details["rule"] in @unheld

  def again?(_ctx, _snapshot, _result), do: false

  @doc "Claims the id of a command that this gateway is to send."
  @spec claim(ctx(), OwnershipCheck.t() | nil) ::
          {:ok, OwnershipCheck.t() | nil} | {:known, Result.t()} | stop()
  def claim(_way, nil), do: {:ok, nil}

  def claim(%{holder: holder, command: command} = ctx, holding) do
    with {holding, :claim} <- OwnershipCheck.handle(holding, {:holder, holder(ctx), now()}),
         patience =
           if(holding.lease == :alone or holding.urgent?,
             do: min(@alone_ms, ctx.patience),
             else: ctx.patience
           ),
         claimed = holder.claim(ctx.gateway, command.vehicle, command.id, patience),
         {holding, :go_on} <- OwnershipCheck.handle(holding, {:claimed, claimed}) do
      {:ok, holding}
    else
      {_over, {:known, %{result: %Result{} = result}}} -> {:known, result}
      {_over, {:known, %{by: by}}} -> {:known, unknown(command, by)}
      {_over, {:refuse, rule, why}} -> refuse(rule, why)
    end
  end

  defp unknown(%{id: id}, by),
    do:
      Result.new(id, :unknown, "the gateway #{by} had this command, and what became of it is not known here")

  @doc "Whether it may be sent now, and what then holds: that no gateway of the fleet sends it again, or that this one does not."
  @spec send?(ctx(), OwnershipCheck.t() | nil) :: {:ok, :fleet | :gateway | :urgent | nil} | stop()
  def send?(_way, nil), do: {:ok, nil}

  def send?(ctx, holding) do
    case OwnershipCheck.handle(holding, {:send?, holder(ctx), now()}) do
      {_over, {:send, promise}} -> {:ok, promise}
      {_over, {:refuse, rule, why}} -> refuse(rule, why)
    end
  end

  @doc """
  Whether the vehicle is still held, for the executor of a command that sends more than one message; nil if no other gateway can hold it.
  `:promise` of the context is the answer of `send?/2`.
  """
  @spec still?(ctx()) :: (-> boolean()) | nil
  def still?(%{promise: promise}) when promise in [nil, :urgent], do: nil
  # Its shadow may be restarting, so that it knows nothing for a moment.
  def still?(%{promise: :gateway} = ctx), do: fn -> not match?({:other, _name}, holder(ctx)) end

  def still?(ctx) do
    fn ->
      case holder(ctx) do
        :alone -> true
        {:mine, until} -> now() < until
        _other_or_unknown -> false
      end
    end
  end

  @doc "Tells the others of the result, and says in it what holds."
  @spec done(Result.t(), ctx(), :fleet | :gateway | :urgent | nil) :: Result.t()
  def done(result, _way, nil), do: result

  def done(result, %{holder: holder} = ctx, promise) do
    promise = if promise == :urgent, do: :gateway, else: promise
    result = %{result | details: Map.put(result.details, "once", Atom.to_string(promise))}
    :ok = holder.done(ctx.gateway, ctx.command.vehicle, result)
    result
  end

  defp holder(%{holder: holder, gateway: gateway, command: command}),
    do: holder.holder(gateway, command.vehicle)

  defp refuse(rule, why), do: {:stop, :denied, rule, why <> "; nothing was sent"}
  defp now, do: System.monotonic_time(:millisecond)
end
