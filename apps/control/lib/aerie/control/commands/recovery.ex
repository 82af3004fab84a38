defmodule Aerie.Control.Commands.Recovery do
  @moduledoc """
  Looks after commands that were under way when the gateway was stopped. They are `unknown`, and are never sent again; as soon as
  their vehicle is heard, its state may show that it did them.

  A command whose state is not shown within ten seconds after the vehicle is heard stays `unknown`. While the vehicle
  is not heard, it waits.
  """
  use GenServer

  alias Aerie.Base.{Names, Store}
  alias Aerie.Control.Ledger
  alias Aerie.Vehicle.{Command, Firmware, Protocol}
  alias Aerie.Vehicle.Command.{Refusal, Result}
  alias Aerie.Control.Commands.Record
  alias Aerie.Vehicle.Protocol.Condition
  alias Aerie.Control.CommandExecutor.Observed

  @look_ms 500
  @settle_us 10_000_000
  @retry_ms 1_000

  @spec start_link(gateway: Names.gateway()) :: GenServer.on_start()
  def start_link(options),
    do:
      GenServer.start_link(__MODULE__, options[:gateway],
        name: Names.via(options[:gateway], :command_recovery)
      )

  @doc """
  What a vehicle's snapshot says about a command: its state shows it (`:shown`), does not or not yet (`:not_shown`), or can
  never show it (`:cannot_tell`).
  """
  @spec evaluate(Command.t(), map()) :: :shown | :not_shown | :cannot_tell
  def evaluate(command, snapshot) do
    vehicle = Observed.vehicle(snapshot, {1, 1})

    with {:ok, steps} <- Protocol.plan(Firmware.of(snapshot.autopilot), command, vehicle),
         condition when condition not in [nil, :told] <- List.last(steps).confirm,
         # How often it had booted before, died with the earlier gateway.
         false <- match?({:booted, _count}, condition) do
      if Condition.met?(condition, vehicle), do: :shown, else: :not_shown
    else
      # A missing value, such as its position, may still come.
      {:error, _reason} -> :not_shown
      _nothing_to_see -> :cannot_tell
    end
  end

  @impl GenServer
  def init(gateway) do
    Process.set_label({:command_recovery, gateway})
    {:ok, %{gateway: gateway, since: now(), waiting: %{}}, {:continue, :ask}}
  end

  @impl GenServer
  def handle_continue(:ask, state), do: ask(state)

  @impl GenServer
  def handle_info(:ask, state), do: ask(state)

  def handle_info(:look, state) do
    waiting =
      Map.new(state.waiting, fn {id, {command, heard}} -> {id, find_evidence(state, command, heard)} end)
      |> Map.reject(&match?({_id, :done}, &1))

    {:noreply, again(%{state | waiting: waiting})}
  end

  # The ledger's folder may still belong to a gateway that is dying.
  defp ask(state) do
    case Ledger.interrupted(state.gateway) do
      {:error, _reason} ->
        Process.send_after(self(), :ask, @retry_ms)
        {:noreply, state}

      envelopes ->
        {:noreply, again(%{state | waiting: Map.new(envelopes, &{&1["id"], {read(&1), nil}})})}
    end
  end

  # As at the time of its issue, or it would be too old.
  defp read(envelope) do
    with {:ok, at, _offset} <- DateTime.from_iso8601(envelope["issued_at"] || ""),
         {:ok, command} <- Command.parse(envelope, DateTime.to_unix(at, :microsecond)) do
      command
    else
      _of_another_version -> nil
    end
  end

  # `heard`: when the vehicle was first heard.
  defp find_evidence(_state, nil, _heard), do: :done

  defp find_evidence(state, command, heard) do
    case Store.vehicle(state.gateway, command.vehicle) do
      %{last_heard: last} = snapshot when is_integer(last) and last >= state.since ->
        heard = heard || now()
        verdict(state, command, evaluate(command, snapshot), heard)

      _not_heard ->
        {command, heard}
    end
  end

  defp verdict(state, command, :shown, _heard) do
    finish(state, command, Refusal.ended(:shown_after_stop))
  end

  defp verdict(state, command, verdict, heard) do
    cond do
      verdict == :cannot_tell -> finish(state, command, Refusal.ended(:unshowable_after_stop))
      now() - heard > @settle_us -> finish(state, command, Refusal.ended(:not_shown_after_stop))
      true -> {command, heard}
    end
  end

  defp finish(state, command, {status, reason}) do
    details = %{"vehicle" => command.vehicle, "type" => command.type, "interrupted" => true}
    result = Result.new(command.id, status, reason, details)
    _ = Ledger.finish(state.gateway, result)
    Record.done(state.gateway, command, result, nil)
    :done
  end

  defp again(%{waiting: waiting} = state) when waiting == %{}, do: state

  defp again(state) do
    Process.send_after(self(), :look, @look_ms)
    state
  end

  defp now, do: System.os_time(:microsecond)
end
