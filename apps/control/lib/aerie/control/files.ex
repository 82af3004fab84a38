defmodule Aerie.Control.Files do
  @moduledoc """
  The files of a vehicle by MAVLink FTP, for programs in Elixir:

      {:ok, entries} = Aerie.Control.Files.list(gateway, "VID-001", "/APM")
      {:ok, bytes} = Aerie.Control.Files.read(gateway, "VID-001", "/APM/LOGS/LASTLOG.TXT")

  The options of all functions are those of `t:Aerie.Control.Transfers.option/0`. A path has at most 239 bytes; the vehicle defines
  what its beginning means. Names that are not UTF-8 on board are text as `Aerie.Control.Ftp.Name` writes it (`caf\\xE9.txt`), in both
  directions. A refusal is `:failed` or `:rejected`; for a file that the vehicle does not have, with the rule `"file"`.
  """

  @behaviour Aerie.Control.Commands.Change

  alias Aerie.Base.Names
  alias Aerie.Control.Transfers
  alias Aerie.Vehicle.Command.{Error, Result}
  alias Aerie.Control.Commands.Change
  alias Aerie.Control.Ftp.{Client, Name}
  alias Aerie.Control.Policy.Intent
  alias Aerie.Control.Transfers.Spool

  # A folder has no size that is known before, and a checksum takes as long as the file is large.
  @short_ms 600_000
  # How long a file is that is read, the vehicle says when it is opened.
  @read_ms 86_400_000
  @byte_ms 4
  @max_bytes Client.max_bytes()

  @typedoc "An entry of a folder; the size is nil for folders, and if the vehicle does not report it."
  @type entry :: %{kind: :file | :directory, name: String.t(), size: non_neg_integer() | nil}

  @doc "The entries of a folder, 10,000 at most."
  @spec list(Names.gateway(), vehicle :: String.t(), Path.t(), [Transfers.option()]) ::
          {:ok, [entry()]} | {:error, Result.t()}
  def list(gateway, vehicle, path, options \\ []), do: ask(gateway, vehicle, {:list, path}, options)

  @doc "The CRC-32 of a file, computed by the vehicle."
  @spec crc(Names.gateway(), vehicle :: String.t(), Path.t(), [Transfers.option()]) ::
          {:ok, non_neg_integer()} | {:error, Result.t()}
  def crc(gateway, vehicle, path, options \\ []), do: ask(gateway, vehicle, {:crc, path}, options)

  @doc """
  The bytes of a file of at most 16 MiB, or `max_bytes: n`. With `into: path` they go into a file of this machine without that limit,
  and the answer is its size. The name is `path` with `.part` until it is complete. An interrupted download continues if the vehicle's
  checksum of the file is the same as before; without checksums, and for a file that the vehicle makes while it is read, it begins again.
  """
  @spec read(Names.gateway(), vehicle :: String.t(), Path.t(), [
          Transfers.option() | {:max_bytes, pos_integer()} | {:into, Path.t()}
        ]) :: {:ok, binary() | non_neg_integer()} | {:error, Result.t()}
  def read(gateway, vehicle, path, options \\ []) do
    {into, options} = Keyword.pop(options, :into)
    {max_bytes, options} = Keyword.pop(options, :max_bytes, if(into, do: Spool.max_bytes(), else: @max_bytes))

    with {:ok, snapshot} <- Transfers.vehicle(gateway, vehicle) do
      reading = fn offset, acc, fun ->
        more = [offset: offset, max_bytes: max_bytes]
        Transfers.read(gateway, snapshot, machine({:read, path}, more, @read_ms), options, acc, fun)
      end

      if into,
        do: with({:ok, crc} <- checksum(gateway, vehicle, path, options), do: Spool.fill(into, crc, reading)),
        else: in_memory(reading)
    end
  end

  defp checksum(_gateway, _vehicle, "@" <> _made, _options), do: {:ok, nil}

  defp checksum(gateway, vehicle, path, options) do
    # A server without checksums refuses the request.
    with {:error, %Result{status: :failed}} <-
           crc(gateway, vehicle, path, Keyword.delete(options, :timeout_ms)),
         do: {:ok, nil}
  end

  defp in_memory(reading) do
    case reading.(0, [], fn {:data, offset, bytes}, pieces -> [{offset, bytes} | pieces] end) do
      {{:ok, _size}, pieces} ->
        {:ok, pieces |> Enum.sort() |> Enum.map(&elem(&1, 1)) |> IO.iodata_to_binary()}

      {error, _pieces} ->
        error
    end
  end

  @doc """
  Creates or replaces a file of at most 16 MiB, and compares checksums: `:completed`; `:accepted` if the vehicle has no checksums. Needs the
  permission `maintain`, and `protection` for files that hold parameters, missions or scripts.
  """
  @spec write(Names.gateway(), vehicle :: String.t(), Path.t(), binary(), [Transfers.option()]) ::
          Transfers.answer()
  def write(gateway, vehicle, path, bytes, options \\ [])

  def write(_gateway, _vehicle, _path, bytes, _options) when byte_size(bytes) > @max_bytes,
    do: {:error, [Error.new("file", "at most #{@max_bytes} bytes", byte_size(bytes))]}

  def write(gateway, vehicle, path, bytes, options) do
    digest = Base.encode16(:crypto.hash(:sha256, bytes), case: :lower)
    params = %{action: "write", path: path, bytes: byte_size(bytes), digest: digest}
    change(gateway, vehicle, {:write, path, bytes}, params, options)
  end

  @doc "Removes a file. Needs the permissions of `write/5`."
  @spec remove(Names.gateway(), vehicle :: String.t(), Path.t(), [Transfers.option()]) :: Transfers.answer()
  def remove(gateway, vehicle, path, options \\ []),
    do: change(gateway, vehicle, {:remove, path}, %{action: "remove", path: path}, options)

  defp ask(gateway, vehicle, operation, options) do
    with {:ok, snapshot} <- Transfers.vehicle(gateway, vehicle) do
      transfer = operation |> machine([], @short_ms) |> Map.put(:share, operation)
      {result, nil} = Transfers.read(gateway, snapshot, transfer, options)
      result
    end
  end

  defp change(gateway, vehicle, operation, params, options) do
    path = Name.bytes(params.path)

    if String.valid?(params.path) and byte_size(path) <= 239 do
      change = %Change{
        module: __MODULE__,
        what: operation,
        facts: Intent.write_file(path),
        params: params,
        limit_ms: limit_ms(operation)
      }

      Transfers.change(gateway, vehicle, change, options)
    else
      {:error, [Error.new("path", "text of at most 239 bytes", params.path)]}
    end
  end

  defp limit_ms({:write, _path, bytes}), do: Transfers.time_ms(byte_size(bytes), @byte_ms)
  defp limit_ms({:remove, _path}), do: Transfers.time_ms(0, @byte_ms)

  @impl Change
  def review(_operation, _gateway, _snapshot, _policy, _context), do: :allow

  @impl Change
  def transfer(operation, _gateway, _snapshot), do: {:ok, machine(operation, [], limit_ms(operation))}

  defp machine(operation, more, timeout_ms) do
    %{
      lanes: [:file],
      timeout_ms: timeout_ms,
      start: fn context, until ->
        options = [us: context.us, seq: context.seq, rtt_us: context.rtt_us] ++ more
        {:ok, Client.new(operation, context.target, until, options)}
      end
    }
  end
end
