defmodule AerieCLI.Ports do
  @moduledoc """
  Finds free ports for parts that use their default port, so that a demo starts beside other programs. A configured
  port that is taken is an error, which `Aerie.Config.Preflight` reports.
  """

  @tries 50

  @doc "The first free TCP port at `address`, from `port` upwards; 50 ports are tried."
  @spec free_tcp(:inet.ip_address(), :inet.port_number()) :: {:ok, :inet.port_number()} | {:error, :none_free}
  def free_tcp(address, port), do: first(port, &tcp_free?(address, &1))

  @doc "The first free UDP port at `address`, from `port` upwards; 50 ports are tried."
  @spec free_udp(:inet.ip_address(), :inet.port_number()) :: {:ok, :inet.port_number()} | {:error, :none_free}
  def free_udp(address, port), do: first(port, &udp_free?(address, &1))

  defp first(port, free?) do
    candidates = port..min(port + @tries - 1, 65_535)

    case Enum.find(candidates, free?) do
      nil -> {:error, :none_free}
      found -> {:ok, found}
    end
  end

  defp tcp_free?(address, port) do
    case :gen_tcp.listen(port, ip: address, reuseaddr: true) do
      {:ok, socket} -> :gen_tcp.close(socket) == :ok
      {:error, _taken} -> false
    end
  end

  defp udp_free?(address, port) do
    case :gen_udp.open(port, ip: address) do
      {:ok, socket} -> :gen_udp.close(socket) == :ok
      {:error, _taken} -> false
    end
  end
end
