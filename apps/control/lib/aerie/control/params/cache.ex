defmodule Aerie.Control.Params.Cache do
  @moduledoc """
  Parameter lists on disk, one file for each vehicle. If there are too many files, the oldest one is
  removed.

  A stored list may be out of date. Only the vehicle can tell: `freshness/2` compares
  PX4's `_HASH_CHECK`, or the checksum of ArduPilot's parameter file, with the stored one. An equal number of
  parameters proves nothing; a different one proves that the list is old.

  The first line names format, version and CRC-32 of the rest, which is JSON. A file of another version, a damaged file and one of
  another vehicle are ignored.
  """

  alias Aerie.Control.Params.{Param, Table}
  alias Aerie.Base.Files.Private

  @format "aerie-params"
  @version 2
  @max_bytes 2_097_152

  @typedoc "The unique id that the vehicle reports, or its network and system id if it reports none."
  @type key :: {:uid, String.t()} | {:system, network :: String.t(), system :: non_neg_integer()}

  @typedoc "What the vehicle reports now; nil or missing: not known."
  @type evidence :: %{
          optional(:hash) => non_neg_integer() | nil,
          optional(:file_crc) => non_neg_integer() | nil,
          optional(:count) => non_neg_integer() | nil
        }

  @doc "Whether the vehicle still has a stored list: `:fresh` and `:stale` are certain; treat `:unknown` as stale."
  @spec freshness(Table.t(), evidence()) :: :fresh | :stale | :unknown
  def freshness(table, evidence) do
    verdicts = [
      same(table.hash, evidence[:hash]),
      same(table.file_crc, evidence[:file_crc]),
      if(evidence[:count] not in [nil, Table.count(table)], do: :stale)
    ]

    cond do
      :stale in verdicts -> :stale
      :fresh in verdicts -> :fresh
      true -> :unknown
    end
  end

  defp same(nil, _now), do: nil
  defp same(_then, nil), do: nil
  defp same(value, value), do: :fresh
  defp same(_then, _now), do: :stale

  @doc "Stores a list in place of the vehicle's previous one, in a folder of limited size."
  @spec store(Path.t(), key(), Table.t(), max_files :: pos_integer()) :: :ok | {:error, File.posix()}
  def store(dir, key, table, max_files) do
    body = JSON.encode!(plain(key, table))

    with :ok <- Private.folder(dir),
         :ok <- Private.write(path(dir, key), [header(body), "\n", body]),
         do: bound(dir, path(dir, key), max_files)
  end

  defp bound(dir, kept, max_files) do
    files = dir |> Path.join("*.params") |> Path.wildcard() |> List.delete(kept)
    surplus = length(files) + 1 - max_files

    if surplus > 0 do
      files |> Enum.sort_by(&written/1) |> Enum.take(surplus) |> Enum.each(&File.rm/1)
    end

    :ok
  end

  defp written(path) do
    case File.stat(path, time: :posix) do
      {:ok, %{mtime: at}} -> at
      {:error, _gone} -> 0
    end
  end

  @doc "The stored list of a vehicle; `:none` if there is no complete file of this vehicle."
  @spec load(Path.t(), key()) :: {:ok, Table.t()} | :none
  def load(dir, key) do
    with {:ok, %{size: size}} when size <= @max_bytes <- File.stat(path(dir, key)),
         {:ok, text} <- File.read(path(dir, key)),
         [first, body] <- String.split(text, "\n", parts: 2),
         true <- first == header(body),
         {:ok, plain} <- JSON.decode(body),
         true <- plain["key"] == plain_key(key) do
      table(plain)
    else
      _none -> :none
    end
  end

  # A hash, because a network's name may have any characters; the key itself is in the file.
  defp path(dir, key) do
    name = :crypto.hash(:sha256, JSON.encode!(plain_key(key)))
    Path.join(dir, binary_part(Base.encode16(name, case: :lower), 0, 32) <> ".params")
  end

  defp header(body), do: "#{@format} #{@version} #{:erlang.crc32(body)}"

  defp plain_key({:uid, uid}), do: ["uid", uid]
  defp plain_key({:system, network, system}), do: ["system", network, system]

  defp plain(key, table) do
    %{
      key: plain_key(key),
      hash: table.hash,
      file_crc: table.file_crc,
      params:
        for(name <- table.order, p = table.params[name], do: [p.name, p.value, p.type, p.default, p.exact])
    }
  end

  # The checksum is right, so the gateway wrote it; a list that is too long is refused nevertheless.
  defp table(%{"params" => params} = plain) when length(params) in 1..5_000//1 do
    params =
      for [name, value, type, default, exact] <- params,
          do: %Param{name: name, value: value, type: type, default: default, exact: exact}

    {:ok, Table.new(params, hash: plain["hash"], file_crc: plain["file_crc"])}
  end

  defp table(_other), do: :none
end
