defmodule Aerie.Link.PortOwner do
  @moduledoc """
  Which program holds a UDP or TCP port or a device of this machine, from Linux' /proc.

  Only processes of the same user (or all, for root) can be told; otherwise, and on other systems, it is `:unknown`.
  """

  @tables %{udp: ["/proc/net/udp", "/proc/net/udp6"], tcp: ["/proc/net/tcp", "/proc/net/tcp6"]}
  @listening "0A"

  # The kernel gives its tables a page at a time: a socket of which one is opened or closed in between can be passed over.
  @looks 5
  # On a busy machine with many processes the answer is not worth waiting for: that the port is taken is known already.
  @patience_ms 2_000

  @doc "The program's name and process id."
  @spec find(:udp | :tcp, :inet.port_number()) :: {:ok, String.t(), pos_integer} | :unknown
  def find(protocol, port), do: look(protocol, port, @looks)

  defp look(_protocol, _port, 0), do: :unknown

  defp look(protocol, port, looks) do
    with [_ | _] = inodes <- inodes(protocol, port), {:ok, _name, _pid} = found <- program(inodes) do
      found
    else
      [] -> look(protocol, port, looks - 1)
      # Somebody else's, whose descriptors are not for us to see.
      :unknown -> :unknown
    end
  end

  @doc "The programs that have a file or device open, symbolic links followed."
  @spec holders(Path.t()) :: [{String.t(), pos_integer}]
  def holders(path) do
    targets = [real(path, 8)]
    for pid <- pids(), holds?(pid, targets), {:ok, name} <- [name(pid)], do: {name, pid}
  end

  @doc "Whether a process was started by this program, itself or by one that it started."
  @spec ours?(pos_integer) :: boolean
  def ours?(pid), do: ours?("#{pid}", System.pid(), 8)

  defp ours?(pid, pid, _generations), do: true
  defp ours?(_pid, _own, 0), do: false

  defp ours?(pid, own, generations) do
    # Behind the program's name, which stands in brackets and may hold anything, come its state and its parent.
    with {:ok, stat} <- File.read("/proc/#{pid}/stat"),
         [_state, parent | _] <- stat |> String.split(")") |> List.last() |> String.split() do
      ours?(parent, own, generations - 1)
    else
      _gone -> false
    end
  end

  defp program(targets) do
    deadline = System.monotonic_time(:millisecond) + @patience_ms
    in_time? = fn _pid -> System.monotonic_time(:millisecond) < deadline end

    with pid when pid != nil <-
           pids() |> own_first() |> Stream.take_while(in_time?) |> Enum.find(&holds?(&1, targets)),
         {:ok, name} <- name(pid) do
      {:ok, name, pid}
    else
      _not_told -> :unknown
    end
  end

  # Two links with one port are the commonest case, and all others take a while to look through.
  defp own_first(pids) do
    own = String.to_integer(System.pid())
    [own | List.delete(pids, own)]
  end

  defp pids do
    case File.ls("/proc") do
      {:ok, names} -> for name <- names, {pid, ""} <- [Integer.parse(name)], do: pid
      {:error, _no_proc} -> []
    end
  end

  defp name(pid), do: with({:ok, name} <- File.read("/proc/#{pid}/comm"), do: {:ok, String.trim(name)})

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
