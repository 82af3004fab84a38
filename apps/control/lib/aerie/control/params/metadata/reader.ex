defmodule Aerie.Control.Params.Metadata.Reader do
  @moduledoc """
  Reads what a vehicle says about its parameters, and about its events: COMPONENT_METADATA, the general file, the file of the
  parameters or events, both by MAVLink FTP. The second one is kept by the checksum that the first one names, and read again only if that
  is another one.
  """

  alias Aerie.Base.Files.Private
  alias Aerie.Base.Names
  alias Aerie.Control.{Files, Transfers}
  alias Aerie.Vehicle.Command.Result
  alias Aerie.Control.Params.Metadata
  alias Aerie.Vehicle.Services.Reports.Definitions
  alias MavCodec.CRC

  @source_ms 30_000
  @max_bytes 4_194_304
  @max_kept 20

  @doc "The descriptions by name; why there are none."
  @spec read(Names.gateway(), String.t(), [Transfers.option()]) ::
          {:ok, %{String.t() => Metadata.t()}} | {:error, Result.t()}
  def read(gateway, vehicle, options),
    do: read(gateway, vehicle, :parameters, &Metadata.decode/1, options)

  @doc "The vehicle's event definitions, or why there are none."
  @spec events(Names.gateway(), String.t(), [Transfers.option()]) ::
          {:ok, Definitions.t()} | {:error, Result.t()}
  def events(gateway, vehicle, options \\ []),
    do: read(gateway, vehicle, :events, &Definitions.decode/1, options)

  defp read(gateway, vehicle, what, decode, options) do
    with {:ok, uri} <- source(gateway, vehicle, options),
         {:ok, _packed, general} <- file(gateway, vehicle, uri, options),
         {:ok, {uri, crc}} <- Metadata.general(general, what),
         {:ok, text} <- text(gateway, vehicle, uri, crc, options) do
      decode.(text)
    end
    |> case do
      {:error, reason} when is_binary(reason) ->
        Transfers.error({:deny, :metadata, reason}, options)

      answer ->
        answer
    end
  end

  defp source(gateway, vehicle, options) do
    with {:ok, snapshot} <- Transfers.vehicle(gateway, vehicle) do
      transfer = %{
        lanes: [:params],
        timeout_ms: @source_ms,
        share: :metadata_source,
        start: fn context, until ->
          {:ok, Metadata.Source.new(context.target, until, rtt_us: context.rtt_us)}
        end
      }

      {result, nil} = Transfers.read(gateway, snapshot, transfer, options)
      result
    end
  end

  defp file(gateway, vehicle, uri, options) do
    with {:ok, path} <- Metadata.path(uri),
         {:ok, packed} <- Files.read(gateway, vehicle, path, [max_bytes: @max_bytes] ++ options),
         {:ok, text} <- Metadata.Unpack.file(path, packed),
         do: {:ok, packed, text}
  end

  defp text(gateway, vehicle, uri, crc, options) do
    case kept(gateway, crc) do
      {:ok, text} -> {:ok, text}
      nil -> fetched(gateway, vehicle, uri, crc, options)
    end
  end

  defp fetched(gateway, vehicle, uri, crc, options) do
    with {:ok, packed, text} <- file(gateway, vehicle, uri, options) do
      # Firmwares differ in whether they mean the file or its content. What is damaged is not kept.
      if crc in [CRC.crc32(packed), CRC.crc32(text), :erlang.crc32(packed), :erlang.crc32(text)],
        do: keep(gateway, crc, text)

      {:ok, text}
    end
  end

  defp kept(_gateway, nil), do: nil

  defp kept(gateway, crc) do
    with path when path != nil <- path(gateway, crc),
         {:ok, text} <- File.read(path),
         do: {:ok, text},
         else: (_none -> nil)
  end

  # Without it the file is read again.
  defp keep(gateway, crc, text) do
    with path when path != nil <- path(gateway, crc),
         :ok <- Private.folder(Path.dirname(path)),
         :ok <- Private.write(path, text) do
      others = path |> Path.dirname() |> Path.join("*.metadata") |> Path.wildcard() |> List.delete(path)
      others |> Enum.sort_by(&age/1) |> Enum.drop(@max_kept - 1) |> Enum.each(&File.rm/1)
    end

    :ok
  end

  # The newest first.
  defp age(path) do
    case File.stat(path, time: :posix) do
      {:ok, %{mtime: at}} -> -at
      {:error, _gone} -> 0
    end
  end

  defp path(gateway, crc) do
    with dir when dir != nil <- Names.value(gateway, :params_cache),
         do: Path.join(dir, Base.encode16(<<crc::32>>) <> ".metadata")
  end
end
