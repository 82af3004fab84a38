defmodule FleetWeb.Console.Access.Limiter do
  @moduledoc """
  Limits attempts to sign in: five a minute from one address, sixty a minute from all. A success resets the
  address' attempts. They are counted before the password is checked, so that refusing them is cheap.
  """
  use GenServer

  alias Aerie.Names

  @window_ms 60_000
  @each 5
  @all 60

  @doc "Options: `:gateway`; for tests `:now`, a function that returns monotonic milliseconds."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :console_limiter))

  @doc "Counts an attempt of an address, or returns how many seconds to wait."
  @spec try(Names.gateway(), :inet.ip_address()) :: :ok | {:wait, pos_integer()}
  def try(gateway, address), do: GenServer.call(Names.via(gateway, :console_limiter), {:try, address})

  @doc "Records that an address signed in successfully."
  @spec succeeded(Names.gateway(), :inet.ip_address()) :: :ok
  def succeeded(gateway, address), do: GenServer.cast(Names.via(gateway, :console_limiter), {:right, address})

  @impl GenServer
  def init(options) do
    now = Keyword.get(options, :now, fn -> System.monotonic_time(:millisecond) end)
    {:ok, %{now: now, tries: []}}
  end

  # At most @all attempts are kept.
  @impl GenServer
  def handle_call({:try, address}, _from, %{now: now} = state) do
    time = now.()
    tries = Enum.filter(state.tries, fn {at, _address} -> time - at < @window_ms end)
    own = Enum.filter(tries, fn {_at, from} -> from == address end)

    case {full(own, @each, time), full(tries, @all, time)} do
      {0, 0} -> {:reply, :ok, %{state | tries: [{time, address} | tries]}}
      {own, all} -> {:reply, {:wait, max(own, all)}, %{state | tries: tries}}
    end
  end

  @impl GenServer
  def handle_cast({:right, address}, state) do
    {:noreply, %{state | tries: Enum.reject(state.tries, fn {_at, from} -> from == address end)}}
  end

  # Seconds until another attempt is allowed; newest first.
  defp full(tries, most, time) do
    case Enum.at(tries, most - 1) do
      nil -> 0
      {at, _address} -> div(@window_ms - (time - at) + 999, 1000)
    end
  end
end
