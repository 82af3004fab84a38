defmodule Aerie.Link.PortOwner do
  @moduledoc """
  Which program holds a UDP or TCP port or a device of this machine, from Linux' /proc.

  Only processes of the same user (or all, for root) can be told; otherwise, and on other systems, it is `:unknown`.
  """

  @tables %{udp: ["/proc/net/udp", "/proc/net/udp6"], tcp: ["/proc/net/tcp", "/proc/net/tcp6"]}
  @listening "0A"

  @doc "The program's name and process id."
  @spec find(:udp | :tcp, :inet.port_number()) :: {:ok, String.t(), pos_integer} | :unknown
  def find(protocol, port) do
    with [_ | _] = inodes <- inodes(protocol, port), do: program(inodes), else: (_none -> :unknown)
  end

  @doc "The program that has a file or device open, symbolic links followed."
  @spec device(Path.t()) :: {:ok, String.t(), pos_integer} | :unknown
  def device(path), do: program([real(path, 8)])

  defp program(targets) do
    with {:ok, pid} <- holder(targets),
         {:ok, name} <- File.read("/proc/#{pid}/comm") do
      {:ok, String.trim(name), pid}
    else
      _not_told -> :unknown
    end
  end

  defp real(path, 0), do: path

  defp real(path, hops) do
    case File.read_link(path) do
      {:ok, target} -> target |> Path.expand(Path.dirname(path)) |> real(hops - 1)
      {:error, _no_link} -> path
    end
  end

  defp inodes(protocol, port) do
    for file <- @tables[protocol],
        {:ok, text} <- [File.read(file)],
        line <- text |> String.split("\n", trim: true) |> Enum.drop(1),
        # sl local rem st queues timer retransmits uid timeout inode …
        [_, local, _, state, _, _, _, _, _, inode | _] <- [String.split(line)],
        protocol == :udp or state == @listening,
        [_, hex] <- [String.split(local, ":")],
        {^port, ""} <- [Integer.parse(hex, 16)],
        do: "socket:[#{inode}]"
  end

  defp holder(targets) do
    with {:ok, names} <- File.ls("/proc") do
      pids = for name <- names, {pid, ""} <- [Integer.parse(name)], do: pid
      Enum.find_value(pids, :unknown, &if(holds?(&1, targets), do: {:ok, &1}))
    end
  end

  defp holds?(pid, targets) do
    folder = "/proc/#{pid}/fd"

    case File.ls(folder) do
      {:ok, names} -> Enum.any?(names, &(target(folder, &1) in targets))
      {:error, _gone_or_foreign} -> false
    end
  end

  defp target(folder, name) do
    with {:ok, target} <- File.read_link(Path.join(folder, name)),
         do: target,
         else: (_closed_meanwhile -> nil)
  end
end
