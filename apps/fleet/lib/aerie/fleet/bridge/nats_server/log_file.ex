defmodule Aerie.Fleet.Bridge.NatsServer.LogFile do
  @max_bytes 524_288

  @moduledoc """
  nats-server's log on disk: at most two files of #{div(@max_bytes, 1024)} KiB, the older one with `.1` at its end. If the disk
  cannot be written, logging stops; the server goes on.
  """

  defstruct [:path, :file, size: 0]
  @type t :: %__MODULE__{path: Path.t() | nil, file: :file.fd() | nil, size: non_neg_integer()}

  @doc "Opens the log for appending."
  @spec open(Path.t()) :: t()
  def open(path) do
    case :file.open(path, [:append, :raw, :binary]) do
      {:ok, file} -> %__MODULE__{path: path, file: file, size: size(path)}
      {:error, _reason} -> %__MODULE__{path: path}
    end
  end

  @doc "Writes a line."
  @spec write(t(), String.t()) :: t()
  def write(%__MODULE__{file: nil} = log, _line), do: log

  def write(%__MODULE__{size: size} = log, line) when size > @max_bytes do
    _ = close(log)
    _ = File.rename(log.path, log.path <> ".1")
    log.path |> open() |> Map.put(:size, 0) |> write(line)
  end

  def write(log, line) do
    case :file.write(log.file, [line, ?\n]) do
      :ok -> %{log | size: log.size + byte_size(line) + 1}
      {:error, _reason} -> log |> close() |> Map.put(:file, nil)
    end
  end

  @doc "Closes the file."
  @spec close(t()) :: t()
  def close(%__MODULE__{file: nil} = log), do: log

  def close(log) do
    _ = :file.close(log.file)
    %{log | file: nil}
  end

  defp size(path) do
    case File.stat(path) do
      {:ok, %{size: size}} -> size
      {:error, _} -> 0
    end
  end
end
