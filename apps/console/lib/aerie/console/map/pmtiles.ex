defmodule Aerie.Console.Map.PMTiles do
  @moduledoc """
  Reads PMTiles version 3: many map tiles in one file. The header and the directories give the offset of a tile; nothing else is read.

  The file is not trusted: sizes are limited, and inconsistent data is an error or no tile.
  """

  import Bitwise

  @header 127
  # The specification allows 16 KiB for the root; leaves and metadata are larger in practice.
  @max_directory 1_048_576
  @max_unpacked 16 * 1_048_576
  @max_tile 4 * 1_048_576
  @max_depth 4
  @max_entries 1_000_000

  @enforce_keys [
    :path,
    :root,
    :leaves,
    :data,
    :compressed?,
    :tile_gzip?,
    :type,
    :min_zoom,
    :max_zoom,
    :bounds,
    :layers
  ]
  defstruct @enforce_keys

  @typedoc "`:root`, `:leaves`, `:data` are offsets in the file, the root's with its length; `:layers` are names in vector tiles."
  @type t :: %__MODULE__{
          path: Path.t(),
          root: {non_neg_integer(), non_neg_integer()},
          leaves: non_neg_integer(),
          data: non_neg_integer(),
          compressed?: boolean(),
          tile_gzip?: boolean(),
          type: :vector | :png | :jpeg | :webp | :avif,
          min_zoom: 0..31,
          max_zoom: 0..31,
          bounds: [float()],
          layers: [String.t()]
        }

  @types %{1 => :vector, 2 => :png, 3 => :jpeg, 4 => :webp, 5 => :avif}

  @doc "Reads the header of a file, or says why the file cannot be used."
  @spec open(Path.t()) :: {:ok, t()} | {:error, String.t()}
  def open(path) do
    with_file(path, fn file ->
      with {:ok, bytes} <- pread(file, 0, @header),
           {:ok, tiles, metadata} <- header(path, bytes),
           {:ok, layers} <- layers(file, tiles, metadata),
           do: {:ok, %{tiles | layers: layers}}
    end)
  end

  @doc "A tile as stored in the file (`:tile_gzip?` says whether it is compressed), or nil."
  @spec tile(t(), z :: integer(), x :: integer(), y :: integer()) ::
          {:ok, binary() | nil} | {:error, String.t()}
  def tile(tiles, z, x, y) when z >= 0 and z <= 31 and x >= 0 and y >= 0 and x < 1 <<< z and y < 1 <<< z do
    with_file(tiles.path, fn file ->
      {offset, length} = tiles.root
      find(tiles, file, id(z, x, y), offset, length, 0)
    end)
  end

  def tile(_tiles, _z, _x, _y), do: {:ok, nil}

  @doc "The number of a tile: all smaller zooms first, then along the Hilbert curve."
  @spec id(non_neg_integer(), non_neg_integer(), non_neg_integer()) :: non_neg_integer()
  def id(z, x, y), do: div((1 <<< (2 * z)) - 1, 3) + hilbert(z - 1, x, y, 0)

  defp hilbert(level, _x, _y, sum) when level < 0, do: sum

  defp hilbert(level, x, y, sum) do
    side = 1 <<< level
    right = if (x &&& side) > 0, do: 1, else: 0
    up = if (y &&& side) > 0, do: 1, else: 0
    {x, y} = turned(right, up, x, y, side)
    hilbert(level - 1, x, y, sum + side * side * bxor(3 * right, up))
  end

  defp turned(_right, 1, x, y, _side), do: {x, y}
  defp turned(0, 0, x, y, _side), do: {y, x}
  # These may be negative; from here on only the lower bits count.
  defp turned(1, 0, x, y, side), do: {side - 1 - y, side - 1 - x}

  defp header(
         path,
         <<"PMTiles", 3, root::little-64, root_length::little-64, metadata::little-64,
           metadata_length::little-64, leaves::little-64, _leaves_length::little-64, data::little-64,
           _data_length::little-64, _counts::binary-24, _clustered, internal, compression, type, min_zoom,
           max_zoom, west::little-signed-32, south::little-signed-32, east::little-signed-32,
           north::little-signed-32, _centre::binary>>
       ) do
    cond do
      internal not in [1, 2] ->
        {:error, "its directories are compressed in a way that is not supported (only gzip is)"}

      compression not in [0, 1, 2] ->
        {:error, "its tiles are compressed in a way that is not supported (only gzip is)"}

      not is_map_key(@types, type) ->
        {:error, "its tiles are of an unknown type"}

      min_zoom > max_zoom or max_zoom > 31 ->
        {:error, "its zooms are wrong"}

      root_length > @max_directory ->
        {:error, "its directory is too large"}

      true ->
        tiles = %__MODULE__{
          path: path,
          root: {root, root_length},
          leaves: leaves,
          data: data,
          compressed?: internal == 2,
          tile_gzip?: compression == 2,
          type: @types[type],
          min_zoom: min_zoom,
          max_zoom: max_zoom,
          bounds: for(n <- [west, south, east, north], do: n / 1.0e7),
          layers: []
        }

        {:ok, tiles, {metadata, metadata_length}}
    end
  end

  defp header(_path, <<"PMTiles", version, _rest::binary>>),
    do: {:error, "it is PMTiles version #{version}; only version 3 is supported"}

  defp header(_path, _other), do: {:error, "it is not a PMTiles file"}

  defp layers(file, %{type: :vector} = tiles, {offset, length}) when length <= @max_directory do
    with {:ok, bytes} <- pread(file, offset, length),
         {:ok, text} <- unpacked(tiles, bytes),
         {:ok, %{"vector_layers" => layers}} when is_list(layers) <- JSON.decode(text) do
      {:ok, for(%{"id" => id} when is_binary(id) <- Enum.take(layers, 200), do: id)}
    else
      _no_layers -> {:error, "its metadata do not name the layers of its vector tiles"}
    end
  end

  defp layers(_file, _raster, _metadata), do: {:ok, []}

  defp find(_tiles, _file, _id, _offset, length, depth) when depth >= @max_depth or length > @max_directory,
    do: {:error, "a directory is too large or too deep"}

  defp find(tiles, file, id, offset, length, depth) do
    with {:ok, bytes} <- pread(file, offset, length),
         {:ok, directory} <- unpacked(tiles, bytes),
         {:ok, entries} <- entries(directory) do
      case last_before(entries, id) do
        {_first, 0, at, size} ->
          find(tiles, file, id, tiles.leaves + at, size, depth + 1)

        {first, run, at, size} when id < first + run and size <= @max_tile ->
          pread(file, tiles.data + at, size)

        _none ->
          {:ok, nil}
      end
    end
  end

  defp last_before(entries, id) do
    Enum.reduce_while(entries, nil, fn {first, _, _, _} = entry, last ->
      if first <= id, do: {:cont, entry}, else: {:halt, last}
    end)
  end

  # The entries of a directory: `{first tile, run (0: a leaf directory), offset, length}`, in four columns one after the other.
  defp entries(bytes) do
    with {count, rest} when count <= @max_entries <- varint(bytes),
         {steps, rest} <- varints(rest, count, []),
         {runs, rest} <- varints(rest, count, []),
         {lengths, rest} <- varints(rest, count, []),
         {offsets, _rest} <- varints(rest, count, []) do
      {:ok, joined(steps, runs, lengths, offsets, 0, 0, [])}
    else
      _broken -> {:error, "a directory is broken"}
    end
  end

  # An offset of 0 means directly after the previous entry.
  defp joined([step | steps], [run | runs], [length | lengths], [offset | offsets], id, next, entries) do
    id = id + step
    at = if offset == 0, do: next, else: offset - 1
    joined(steps, runs, lengths, offsets, id, at + length, [{id, run, at, length} | entries])
  end

  defp joined([], [], [], [], _id, _next, entries), do: Enum.reverse(entries)

  defp varints(rest, 0, values), do: {Enum.reverse(values), rest}

  defp varints(bytes, count, values) do
    with {value, rest} <- varint(bytes), do: varints(rest, count - 1, [value | values])
  end

  defp varint(bytes), do: varint(bytes, 0, 0)

  defp varint(<<1::1, low::7, rest::binary>>, shift, value) when shift < 63,
    do: varint(rest, shift + 7, value + (low <<< shift))

  defp varint(<<0::1, low::7, rest::binary>>, shift, value), do: {value + (low <<< shift), rest}
  defp varint(_ends, _shift, _value), do: :error

  defp unpacked(%{compressed?: false}, bytes), do: {:ok, bytes}

  # Not zlib:gunzip/1, which would let a small file of zeros fill all memory.
  defp unpacked(%{compressed?: true}, bytes) do
    z = :zlib.open()

    try do
      :ok = :zlib.inflateInit(z, 31)
      inflate(z, :zlib.safeInflate(z, bytes), [], 0)
    rescue
      ErlangError -> {:error, "a directory cannot be unpacked"}
    after
      :zlib.close(z)
    end
  end

  defp inflate(z, {how, more}, all, size) do
    size = size + IO.iodata_length(more)

    cond do
      size > @max_unpacked -> {:error, "a directory is too large"}
      how == :finished -> {:ok, IO.iodata_to_binary([all, more])}
      true -> inflate(z, :zlib.safeInflate(z, []), [all, more], size)
    end
  end

  defp pread(_file, _offset, 0), do: {:ok, ""}

  defp pread(file, offset, length) do
    case :file.pread(file, offset, length) do
      {:ok, bytes} when byte_size(bytes) == length -> {:ok, bytes}
      {:ok, _part} -> {:error, "it is shorter than it says"}
      :eof -> {:error, "it is shorter than it says"}
      {:error, reason} -> {:error, "#{:file.format_error(reason)}"}
    end
  end

  defp with_file(path, fun) do
    case :file.open(path, [:read, :raw, :binary]) do
      {:ok, file} ->
        try do
          fun.(file)
        after
          :file.close(file)
        end

      {:error, reason} ->
        {:error, "#{:file.format_error(reason)}"}
    end
  end
end
