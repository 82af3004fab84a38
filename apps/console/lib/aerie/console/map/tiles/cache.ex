defmodule Aerie.Console.Map.Tiles.Cache do
  @moduledoc """
  Fetched tiles on the disk, a file each: a line of JSON with what is known of it, then the tile. The process that
  serves a tile reads it itself. When there are too many bytes, those that nobody has looked at for longest go. A file
  that was cut off is ignored.
  """

  alias Aerie.Base.Files.{Private, Raw}
  alias Aerie.Console.Map.Tiles.Layer

  @day_s 86_400
  @most_files 400_000

  @typedoc "`until`: unix seconds, until then the server is not asked; `body` is empty where it has no tile."
  @type entry :: %{
          type: String.t() | nil,
          gzip?: boolean(),
          etag: String.t() | nil,
          until: integer(),
          body: binary()
        }

  @typedoc "How many tiles a layer has on the disk, and their bytes, by `folder/1`."
  @type held :: %{String.t() => {tiles :: non_neg_integer(), bytes :: non_neg_integer()}}

  @doc "The folder of a layer's tiles. Another address under the same id is another folder."
  @spec folder(Layer.t()) :: String.t()
  def folder(%Layer{id: id, source: {:server, url, _key}}) do
    <<short::binary-4, _rest::binary>> = :crypto.hash(:sha256, url)
    "#{id}-#{Base.encode16(short, case: :lower)}"
  end

  @doc "The file of a tile."
  @spec path(Path.t(), Layer.t(), {integer(), integer(), integer()}) :: Path.t()
  def path(dir, layer, {z, x, y}), do: Path.join([dir, folder(layer), "#{z}", "#{x}", "#{y}"])

  @doc "A tile that is there, or nil."
  @spec read(Path.t(), now :: integer()) :: entry() | nil
  def read(path, now) do
    with {:ok, bytes} <- Raw.read(path),
         [head, body] <- :binary.split(bytes, "\n"),
         {:ok, %{"until" => until, "bytes" => size} = head} when is_integer(until) <- JSON.decode(head),
         ^size <- byte_size(body) do
      _ = touch(path, now)
      %{type: head["type"], gzip?: head["gzip"] == true, etag: head["etag"], until: until, body: body}
    else
      _none -> nil
    end
  end

  # What is used stays. Once a day is enough for that.
  defp touch(path, now) do
    with {:ok, %{mtime: used}} when used < now - @day_s <- Raw.stat(path), do: File.touch(path, now)
  end

  @doc "Keeps a tile."
  @spec write(Path.t(), entry()) :: :ok | {:error, File.posix()}
  def write(path, %{body: body} = entry) do
    head = %{
      type: entry.type,
      gzip: entry.gzip?,
      etag: entry.etag,
      until: entry.until,
      bytes: byte_size(body)
    }

    with :ok <- Private.new_folder(Path.dirname(path)),
         do: Private.write(path, [JSON.encode!(head), ?\n, body], false)
  end

  @doc "Removes tiles until at most so many bytes are left, and says what is left."
  @spec sweep(Path.t(), most :: non_neg_integer()) :: held()
  def sweep(dir, most) do
    files = dir |> files(5) |> Enum.take(@most_files) |> Enum.sort()
    bytes = files |> Enum.map(&elem(&1, 1)) |> Enum.sum()
    # Not one for each that comes.
    left = if bytes > most, do: remove(files, bytes, div(most * 9, 10)), else: files
    depth = length(Path.split(dir))

    Enum.reduce(left, %{}, fn {_used, size, path}, held ->
      add(held, Enum.at(Path.split(path), depth), size)
    end)
  end

  @doc "Counts a tile more."
  @spec add(held(), folder :: String.t(), bytes :: non_neg_integer()) :: held()
  def add(held, folder, size),
    do: Map.update(held, folder, {1, size}, fn {tiles, bytes} -> {tiles + 1, bytes + size} end)

  defp remove([{_used, size, path} | files], bytes, most) when bytes > most do
    _ = Raw.rm(path)
    _ = File.rmdir(Path.dirname(path))
    remove(files, bytes - size, most)
  end

  defp remove(files, _bytes, _most), do: files

  # {last used, bytes, path}; layers, zooms and columns are folders.
  defp files(_path, 0), do: []

  defp files(path, depth) do
    case Raw.lstat(path) do
      {:ok, %{type: :directory}} ->
        case Raw.ls(path) do
          {:ok, names} -> Stream.flat_map(names, &files(Path.join(path, &1), depth - 1))
          {:error, _gone} -> []
        end

      {:ok, %{type: :regular, mtime: used, size: size}} ->
        [{used, size, path}]

      _other ->
        []
    end
  end
end
