defmodule MavRouter.Signing.KeyStore.State do
  @moduledoc """
  The file of time stamps: from the tables to JSON and back, written so that a power cut leaves the old or the new file.

      {"version": 1, "at": 1795..., "link_ids": {"radio-1": 0},
       "links": [{"link": "radio-1", "network": "main", "system": null, "timestamp": 1187..., "streams": [[0, 1, 1, 1187..., 0]]}],
       "ended": true}

  A stream is its link id, system, component, last time stamp, and how far it was ahead of the clock at most (null: unknown). `ended`:
  it was written in an orderly end, after which nothing was received.
  """

  alias MavRouter.Signing.Tables
  alias MavCodec.Signing

  @max_bytes 8_000_000
  @max_timestamp 0xFFFF_FFFF_FFFF

  @type stored :: %{
          link_ids: %{String.t() => 0..255},
          at: integer | nil,
          ended: boolean,
          entries: [
            {{String.t(), MavRouter.Signing.Scope.id()}, Signing.timestamp(),
             %{Signing.stream() => {Signing.timestamp(), integer | nil}}}
          ]
        }

  @doc "The state to store; nil for none."
  @spec collect(Tables.t()) :: term | nil
  def collect(tables) do
    live =
      for {key, _generation, signing} <- :ets.tab2list(tables.verifiers), into: %{} do
        reserved = :ets.lookup_element(tables.reserved, key, 2, 0)
        {key, {max(reserved, Signing.timestamp(signing)), streams(signing)}}
      end

    former =
      for {key, timestamp, streams} <- :ets.tab2list(tables.stored),
          into: %{},
          do: {key, {timestamp, Map.new(streams, fn {stream, last} -> {stream, {last, nil}} end)}}

    entries = former |> Map.merge(live) |> Enum.sort()

    if entries != [] do
      ids = for {{:link_id, link}, number} <- :ets.tab2list(tables.settings), into: %{}, do: {link, number}
      {ids, entries}
    end
  end

  defp streams(signing) do
    ahead = Signing.ahead(signing)
    Map.new(Signing.streams(signing), fn {stream, last} -> {stream, {last, ahead[stream]}} end)
  end

  @doc "The text of the file, for a state at a unix time in microseconds; `ended` in an orderly end."
  @spec encode(term, integer, boolean) :: binary
  def encode({ids, entries}, at, ended) do
    links = Enum.map(entries, &entry/1)
    JSON.encode!(%{"version" => 1, "at" => at, "ended" => ended, "link_ids" => ids, "links" => links})
  end

  defp entry({{link, {network, system}}, {timestamp, streams}}) do
    %{
      "link" => link,
      "network" => network,
      "system" => if(system == :any, do: nil, else: system),
      "timestamp" => timestamp,
      "streams" =>
        for {{link_id, system, component}, {last, ahead}} <- Enum.sort(streams) do
          [link_id, system, component, last, ahead]
        end
    }
  end

  @doc "Reads the file. A missing one is empty, a damaged one an error with a text."
  @spec read(Path.t()) :: {:ok, stored} | {:error, String.t()}
  def read(path) do
    case File.read(path) do
      {:ok, text} when byte_size(text) <= @max_bytes -> decode(text, path)
      {:ok, _long} -> {:error, "#{path} is too long for a file of time stamps"}
      {:error, :enoent} -> {:ok, %{at: nil, ended: true, link_ids: %{}, entries: []}}
      {:error, reason} -> {:error, "#{path}: #{:file.format_error(reason)}"}
    end
  end

  defp decode(text, path) do
    case JSON.decode(text) do
      {:ok, %{"version" => 1, "link_ids" => %{} = ids, "links" => links} = stored} when is_list(links) ->
        ids = for {link, n} <- ids, n in 0..255, into: %{}, do: {link, n}
        at = if is_integer(stored["at"]), do: stored["at"]
        ended = stored["ended"] == true
        {:ok, %{at: at, ended: ended, link_ids: ids, entries: Enum.flat_map(links, &entry_of/1)}}

      _other ->
        {:error, "#{path} is damaged"}
    end
  end

  defp entry_of(%{
         "link" => link,
         "network" => network,
         "system" => system,
         "timestamp" => at,
         "streams" => streams
       })
       when is_binary(link) and is_binary(network) and (is_nil(system) or is_integer(system)) and
              at in 0..@max_timestamp and is_list(streams) do
    streams =
      for [link_id, s, c, t | ahead] when is_integer(t) <- streams,
          into: %{},
          do: {{link_id, s, c}, {t, known(ahead)}}

    [{{link, {network, system || :any}}, at, streams}]
  end

  defp entry_of(_other), do: []

  # Older files lack it.
  defp known([ahead]) when is_integer(ahead), do: ahead
  defp known(_unknown), do: nil

  @doc "Writes the file: under another name, forced to the disk, then renamed. The file and its folder are for the owner only."
  @spec write(Path.t(), binary) :: :ok | {:error, String.t()}
  def write(path, bytes) do
    dir = Path.dirname(path)
    beside = path <> ".new"

    with :ok <- folder(dir),
         {:ok, file} <- :file.open(beside, [:write, :raw, :binary]),
         :ok <- fill(file, beside, bytes),
         :ok <- :file.rename(beside, path) do
      sync(dir)
    else
      {:error, reason} when is_atom(reason) -> {:error, "#{path}: #{:file.format_error(reason)}"}
      {:error, words} -> {:error, words}
    end
  end

  # The folder's entry must be on the disk too, where folders can be opened.
  defp sync(dir) do
    case :file.open(dir, [:read, :raw, :directory]) do
      {:ok, folder} ->
        _ = :file.sync(folder)
        _ = :file.close(folder)
        :ok

      {:error, _cannot} ->
        :ok
    end
  end

  @doc "Makes a folder for its owner only; an existing one stays as it is."
  @spec folder(Path.t()) :: :ok | {:error, String.t()}
  def folder(dir) do
    with false <- File.dir?(dir), :ok <- File.mkdir_p(dir) do
      _ = File.chmod(dir, 0o700)
      :ok
    else
      true -> :ok
      {:error, reason} -> {:error, "#{dir}: #{:file.format_error(reason)}"}
    end
  end

  defp fill(file, path, bytes) do
    with :ok <- File.chmod(path, 0o600), :ok <- :file.write(file, bytes), do: :file.datasync(file)
  after
    :file.close(file)
  end
end
