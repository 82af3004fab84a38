defmodule Aerie.Fleet.Diagnosis.Server do
  @every_ms 10_000
  @fresh_ms 2_000

  @moduledoc """
  Holds a gateway's `Aerie.Fleet.Diagnosis`. It looks every #{div(@every_ms, 1000)} s, so that it knows which counters grew in the last minute,
  and again when somebody asks and the last look is more than #{div(@fresh_ms, 1000)} s old.
  """
  use GenServer

  alias Aerie.Base.Names
  alias Aerie.Fleet.Diagnosis
  alias Aerie.Fleet.Diagnosis.{Condition, Observations}

  @call_ms 5_000

  @doc "Options: `:gateway`; `:every_ms`, `:fresh_ms` for tests."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options) do
    gateway = Keyword.fetch!(options, :gateway)
    GenServer.start_link(__MODULE__, options, name: Names.via(gateway, :diagnosis))
  end

  @doc "The present conditions, as `Aerie.Fleet.Diagnosis.list/1` gives them; `:error` if the server does not run or is busy."
  @spec fetch(Names.gateway()) :: {:ok, [Condition.t()]} | :error
  def fetch(gateway) do
    {:ok, GenServer.call(Names.via(gateway, :diagnosis), :list, @call_ms)}
  catch
    :exit, _absent_or_busy -> :error
  end

  @impl GenServer
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    Process.set_label({:diagnosis, gateway})
    every_ms = Keyword.get(options, :every_ms, @every_ms)
    Process.send_after(self(), :look, every_ms)
    fresh_ms = Keyword.get(options, :fresh_ms, @fresh_ms)

    {:ok,
     %{
       gateway: gateway,
       every_ms: every_ms,
       fresh_ms: fresh_ms,
       diagnosis: Diagnosis.new(),
       conditions: [],
       at: nil
     }}
  end

  @impl GenServer
  def handle_call(:list, _from, state) do
    now = System.monotonic_time(:millisecond)
    state = if state.at == nil or now - state.at >= state.fresh_ms, do: refresh(state, now), else: state
    {:reply, state.conditions, state}
  end

  @impl GenServer
  def handle_info(:look, state) do
    Process.send_after(self(), :look, state.every_ms)
    {:noreply, refresh(state, System.monotonic_time(:millisecond))}
  end

  def handle_info(_stray, state), do: {:noreply, state}

  defp refresh(state, now) do
    {conditions, diagnosis} = Diagnosis.step(state.diagnosis, Observations.of(state.gateway))
    %{state | conditions: conditions, diagnosis: diagnosis, at: now}
  end
end
