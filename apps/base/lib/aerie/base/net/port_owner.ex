defmodule Aerie.Base.Net.PortOwner do
  @moduledoc """
  Which program holds a UDP or TCP port or a device of this machine, according to Linux' /proc.

  Only processes of the same user are visible (to root: all); otherwise, and on other systems, the answer is `:unknown`.
  """

  alias Aerie.Base.Files.Raw

  @tables %{udp: ["/proc/net/udp", "/proc/net/udp6"], tcp: ["/proc/net/tcp", "/proc/net/tcp6"]}
  @listening "0A"

  # The kernel gives its tables a page at a time, and may skip a socket when others are opened or closed in between.
  @attempts 5
  # On a busy machine with many processes the answer is not worth a longer wait: it is known that the port is taken.
  @patience_ms 2_000

  @doc "The program's name and process id."
  @spec find(:udp | :tcp, :inet.port_number()) :: {:ok, String.t(), pos_integer} | :unknown
  def find(protocol, port), do: find(protocol, port, @attempts)

  defp find(_protocol, _port, 0), do: :unknown

  defp find(protocol, port, attempts) do
    with [_ | _] = inodes <- inodes(protocol, port), {:ok, _name, _pid} = found <- program(inodes) do
      found
    else
      [] -> find(protocol, port, attempts - 1)
      # Another user's, whose descriptors we cannot see.
      :unknown -> :unknown
    end
  end

  @doc "The programs that have a file or device open, symbolic links followed."
  @spec holders(Path.t()) :: [{String.t(), pos_integer}]
  def holders(path) do
    targets = [real(path, 8)]
    for pid <- pids(), holds?(pid, targets), {:ok, name} <- [name(pid)], do: {name, pid}
  end

  @doc "Those of the programs that have the file open which also have a lock on it (`flock`), according to the kernel."
  @spec lockers(Path.t(), [{String.t(), pos_integer}]) :: [{String.t(), pos_integer}]
  def lockers(path, holders) do
    with {:ok, %File.Stat{inode: inode}} <- Raw.stat(path), {:ok, text} <- Raw.read("/proc/locks") do
      # number: FLOCK ADVISORY WRITE pid major:minor:inode …
      pids =
        for line <- String.split(text, "\n"),
            [_, "FLOCK", _, _, pid, file | _] <- [String.split(line)],
            String.ends_with?(file, ":#{inode}"),
            do: pid

      Enum.filter(holders, fn {_name, pid} -> "#{pid}" in pids end)
    else
      _unknown -> []
    end
  end

  @doc "Whether a process is a descendant of this program, or the program itself."
  @spec ours?(pos_integer) :: boolean
  def ours?(pid), do: descends?("#{pid}", System.pid(), 8)

  @doc "Whether a process or one that it has started, and so on, holds a UDP or TCP port."
  @spec holds_port?(:udp | :tcp, :inet.port_number(), pos_integer) :: boolean
  def holds_port?(protocol, port, pid) do
    with {:ok, _name, holder} <- find(protocol, port),
         do: descends?("#{holder}", "#{pid}", 8),
         else: (:unknown -> false)
  end

  defp descends?(pid, pid, _generations), do: true
  defp descends?(_pid, _own, 0), do: false

  defp descends?(pid, own, generations) do
    # State and parent follow the program's name, which stands in parentheses and may contain anything.
    with {:ok, stat} <- Raw.read("/proc/#{pid}/stat"),
         [_state, parent | _] <- stat |> String.split(")") |> List.last() |> String.split() do
      descends?(parent, own, generations - 1)
    else
      _gone -> false
    end
  end

  defp program(targets) do
    deadline = System.monotonic_time(:millisecond) + @patience_ms
    own = String.to_integer(System.pid())
    in_time? = fn pid -> pid == own or System.monotonic_time(:millisecond) < deadline end

    with pid when pid != nil <-
           pids() |> own_first(own) |> Stream.take_while(in_time?) |> Enum.find(&holds?(&1, targets)),
         {:ok, name} <- name(pid) do
      {:ok, name, pid}
    else
      _not_found -> :unknown
    end
  end

  # Two links with the same port are the commonest case, and all other processes take a while.
  defp own_first(pids, own), do: [own | List.delete(pids, own)]

  defp pids do
    case Raw.ls("/proc") do
      {:ok, names} -> for name <- names, {pid, ""} <- [Integer.parse(name)], do: pid
      {:error, _no_proc} -> []
    end
  end

  defp name(pid), do: with({:ok, name} <- Raw.read("/proc/#{pid}/comm"), do: {:ok, String.trim(name)})

  defp real(path, 0), do: path

  defp real(path, hops) do
    case Raw.read_link(path) do
      {:ok, target} -> target |> Path.expand(Path.dirname(path)) |> real(hops - 1)
      {:error, _no_link} -> path
    end
  end

  defp inodes(protocol, port) do
    for file <- @tables[protocol],
        {:ok, text} <- [Raw.read(file)],
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

    case Raw.ls(folder) do
      {:ok, names} -> Enum.any?(names, &(target(folder, &1) in targets))
      {:error, _gone_or_foreign} -> false
    end
  end

  defp target(folder, name) do
    with {:ok, target} <- Raw.read_link(Path.join(folder, name)),
         do: target,
         else: (_closed_meanwhile -> nil)
  end
end
