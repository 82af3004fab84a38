defmodule Aerie.Access.Limiter do
  @moduledoc """
  Limits attempts to sign in, by `Aerie.Access.Limiter.Attempts`. An attempt is counted before its password is looked at, so that
  refusing it is cheap. One that is to be delayed waits here; of each account 32 may.
  """
  use GenServer

  alias Aerie.Base.Names
  alias Aerie.Access.Limiter.Attempts

  @most_delayed 32

  @doc "Options: `:gateway`; for tests `:now`, a function that returns monotonic milliseconds."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :console_limiter))

  @doc """
  Counts an attempt of an address for an account, a name as somebody typed it. Returns when the password may be looked at, and whether the
  address is known; or how many seconds to wait.
  """
  @spec try(Names.gateway(), :inet.ip_address(), term()) ::
          {:ok, known? :: boolean()} | {:wait, pos_integer()}
  def try(gateway, address, account),
    do:
      GenServer.call(Names.via(gateway, :console_limiter), {:try, Attempts.place(address), account(account)})

  @doc "Records the outcome of an attempt."
  @spec outcome(Names.gateway(), :inet.ip_address(), term(), :right | :wrong | :none) :: :ok
  def outcome(gateway, address, account, outcome) do
    message = {:outcome, Attempts.place(address), account(account), outcome}
    GenServer.cast(Names.via(gateway, :console_limiter), message)
  end

  # However long a name is, it takes the same room.
  defp account(name), do: :erlang.phash2(name, 4_294_967_296)

  @impl GenServer
  def init(options) do
    now = Keyword.get(options, :now, fn -> System.monotonic_time(:millisecond) end)
    {:ok, %{now: now, attempts: %Attempts{}, delayed: %{}}}
  end

  @impl GenServer
  def handle_call({:try, place, account}, from, %{now: now, delayed: delayed} = state) do
    known? = Attempts.known?(state.attempts, place)
    waiting = Map.get(delayed, account, 0)

    case Attempts.try(state.attempts, place, account, now.()) do
      {:ok, 0, attempts} ->
        {:reply, {:ok, known?}, %{state | attempts: attempts}}

      {:ok, _delay, _attempts} when waiting >= @most_delayed ->
        {:reply, {:wait, 5}, state}

      {:ok, delay, attempts} ->
        Process.send_after(self(), {:delayed, account, from}, delay)
        {:noreply, %{state | attempts: attempts, delayed: Map.put(delayed, account, waiting + 1)}}

      {:wait, seconds} ->
        {:reply, {:wait, seconds}, state}
    end
  end

  @impl GenServer
  def handle_cast({:outcome, place, account, outcome}, %{now: now} = state),
    do: {:noreply, %{state | attempts: Attempts.outcome(state.attempts, place, account, outcome, now.())}}

  @impl GenServer
  def handle_info({:delayed, account, from}, %{delayed: delayed} = state) do
    GenServer.reply(from, {:ok, false})

    case delayed do
      %{^account => 1} -> {:noreply, %{state | delayed: Map.delete(delayed, account)}}
      %{^account => n} -> {:noreply, %{state | delayed: %{delayed | account => n - 1}}}
    end
  end
end
