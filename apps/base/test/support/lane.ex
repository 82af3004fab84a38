defmodule Aerie.Lane do
  @moduledoc """
  The lane of tests with a whole gateway or a browser: two of them for each core run at once, in all suites of a run of
  `bin/test` together. One for each core leaves the cores idle half of the time, because most of these tests wait for
  vehicles that fly; more only make each other late.

  A place is an abstract Unix socket that one process can listen on, so it is free again however its process ends.
  """

  @doc """
  An ExUnit setup that waits for a place and keeps it until the test and its processes have ended. The persistent term
  `{Aerie.Lane, module, test}` has the microseconds that it waited.
  """
  @spec setup(map()) :: :ok
  def setup(context) do
    {waited, place} = :timer.tc(fn -> take(places()) end)
    :persistent_term.put({__MODULE__, context.module, context.test}, waited)
    ExUnit.Callbacks.on_exit(fn -> leave(place) end)
  end

  @doc "Waits for one of these places. It stays taken until `leave/1`, or until the process that this returns ends."
  @spec take([String.t()]) :: pid()
  def take(places) do
    caller = self()
    {holder, ref} = spawn_monitor(fn -> hold(places, caller) end)

    receive do
      {^holder, :holds} ->
        Process.demonitor(ref, [:flush])
        holder

      {:DOWN, ^ref, :process, ^holder, reason} ->
        raise "no place in the lane: #{inspect(reason)}"
    end
  end

  @doc "Frees a place."
  @spec leave(pid()) :: :ok
  def leave(holder) do
    send(holder, :leave)
    :ok
  end

  # All suites of a run have the same places.
  defp places do
    run = System.get_env("AERIE_TEST_RUN") || System.pid()
    for n <- 1..(2 * System.schedulers_online()), do: "aerie-lane #{run} #{n}"
  end

  defp hold(places, caller) do
    case Enum.find_value(places, &listen/1) do
      nil ->
        wait(places)
        hold(places, caller)

      socket ->
        send(caller, {self(), :holds})

        receive do
          :leave -> :gen_tcp.close(socket)
        end
    end
  end

  defp listen(place) do
    case :gen_tcp.listen(0, ifaddr: address(place), backlog: 1_000) do
      {:ok, socket} -> socket
      {:error, :eaddrinuse} -> nil
    end
  end

  # Nobody accepts a connection to a place; it ends with the place. One that fails was to a free place.
  defp wait(places) do
    sockets =
      for place <- places, {:ok, socket} <- [:gen_tcp.connect(address(place), 0, active: true)], do: socket

    if length(sockets) == length(places) do
      receive do
        {:tcp_closed, _socket} -> :left
        {:tcp_error, _socket, _reason} -> :left
      end
    end

    Enum.each(sockets, &:gen_tcp.close/1)
  end

  defp address(place), do: {:local, <<0, place::binary>>}
end
