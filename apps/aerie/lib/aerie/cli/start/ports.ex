defmodule Aerie.CLI.Start.Ports do
  @moduledoc """
  Finds free ports for parts that use their default port, so that a demo starts beside other programs. A configured
  port that is taken is an error, which `Aerie.Config.Preflight` reports.

  Two gateways that start at the same time would find the same port, because neither has opened it yet. So a port that was
  found is reserved for ten seconds, by an abstract unix socket of its name, which only one program can have (Linux; elsewhere
  nothing is reserved).
  """
  use GenServer

  @tries 50
  @reserved_ms 10_000

  @spec start_link(term()) :: GenServer.on_start()
  def start_link(_options), do: GenServer.start_link(__MODULE__, nil, name: __MODULE__)

  @doc "The first free TCP port at `address`, from `port` upwards; 50 ports are tried."
  @spec free_tcp(:inet.ip_address(), :inet.port_number()) :: {:ok, :inet.port_number()} | {:error, :none_free}
  def free_tcp(address, port), do: GenServer.call(__MODULE__, {:tcp, address, port}, :infinity)

  @doc "The first free UDP port at `address`, from `port` upwards; 50 ports are tried."
  @spec free_udp(:inet.ip_address(), :inet.port_number()) :: {:ok, :inet.port_number()} | {:error, :none_free}
  def free_udp(address, port), do: GenServer.call(__MODULE__, {:udp, address, port}, :infinity)

  @impl GenServer
  def init(nil), do: {:ok, nil}

  @impl GenServer
  def handle_call({protocol, address, port}, _from, nil) do
    candidates = port..min(port + @tries - 1, 65_535)

    case Enum.find(candidates, &take?(protocol, address, &1)) do
      nil -> {:reply, {:error, :none_free}, nil}
      found -> {:reply, {:ok, found}, nil}
    end
  end

  @impl GenServer
  def handle_info({:release, reservation}, nil) do
    :gen_udp.close(reservation)
    {:noreply, nil}
  end

  # Reserved first: the former holder of the reservation has opened the port by now.
  defp take?(protocol, address, port) do
    case reserve(protocol, port) do
      {:ok, reservation} ->
        free? = free?(protocol, address, port)
        _ = if free?, do: release_later(reservation), else: :gen_udp.close(reservation)
        free?

      {:error, :eaddrinuse} ->
        false

      {:error, _no_such_sockets} ->
        free?(protocol, address, port)
    end
  end

  defp reserve(protocol, port),
    do: :gen_udp.open(0, [:local, active: false, ip: {:local, "\0aerie-#{protocol}-#{port}"}])

  defp release_later(reservation), do: Process.send_after(self(), {:release, reservation}, @reserved_ms)

  defp free?(:tcp, address, port) do
    case :gen_tcp.listen(port, ip: address, reuseaddr: true) do
      {:ok, socket} -> :gen_tcp.close(socket) == :ok
      {:error, _taken} -> false
    end
  end

  defp free?(:udp, address, port) do
    case :gen_udp.open(port, ip: address) do
      {:ok, socket} -> :gen_udp.close(socket) == :ok
      {:error, _taken} -> false
    end
  end
end
