defmodule Aerie.Console.Map.Tiles.Upload do
  @moduledoc """
  Writes a PMTiles file that an admin sends into the folder of uploaded files, as it comes: one at a time, no larger
  than
  allowed, only if the disk has room for it, and under its name only when all of it is there and can be read. What was
  left of one that broke off is overwritten by the next.
  """

  alias Aerie.Base.Files.{Disk, Private, Raw}
  alias Aerie.Base.Names
  alias Aerie.Console.Map.Tiles.Pmtiles

  @most 20
  # What stays free on the disk.
  @spare 200_000_000
  @piece %{length: 1_000_000, period: 20_000}

  @type result :: {:ok, :cowboy_req.req()} | {:error, status :: pos_integer(), String.t(), :cowboy_req.req()}

  @doc "The file of a name."
  @spec path(Path.t(), String.t()) :: Path.t()
  def path(dir, name), do: Path.join(dir, name <> ".pmtiles")

  @doc "The names of the files that are there."
  @spec names(Path.t()) :: [String.t()]
  def names(dir),
    do: for(path <- Path.wildcard(path(dir, "*")), do: Path.basename(path, ".pmtiles")) |> Enum.sort()

  @doc "Whether a file may have a name."
  @spec name?(term()) :: boolean()
  def name?(name), do: is_binary(name) and name =~ ~r/\A[A-Za-z0-9_-]{1,40}\z/

  @doc "Stores the body of a request."
  @spec store(Names.gateway(), Path.t(), name :: String.t(), most :: pos_integer(), :cowboy_req.req()) ::
          result()
  def store(gateway, dir, name, most, request) do
    size = :cowboy_req.body_length(request)

    with {:size, true} <- {:size, is_integer(size)},
         {:most, true} <- {:most, size <= most},
         {:name, true} <- {:name, name?(name)},
         {:count, true} <- {:count, name in names(dir) or length(names(dir)) < @most},
         :ok <- Private.new_folder(dir),
         {:room, true} <- {:room, room?(dir, size)},
         :ok <- Names.register(gateway, :console_map_upload, nil) do
      write(Path.join(dir, ".upload"), path(dir, name), request)
    else
      {:size, _} ->
        {:error, 411, "the length of the file is missing", request}

      {:most, _} ->
        {:error, 413, "the file may have #{div(most, 1_000_000)} MB (console.map.upload_mb)", request}

      {:name, _} ->
        {:error, 422, "a name has 1 to 40 letters, digits, - and _", request}

      {:count, _} ->
        {:error, 409, "there are #{@most} files already: remove one first", request}

      {:room, _} ->
        {:error, 507, "the disk has no room for it", request}

      {:error, :taken} ->
        {:error, 409, "another file is being uploaded", request}

      {:error, reason} ->
        {:error, 500, "#{dir}: #{:file.format_error(reason)}", request}
    end
  end

  defp room?(dir, size) do
    case Disk.free(dir) do
      {:ok, free} -> free >= size + @spare
      :unknown -> true
    end
  end

  defp write(part, path, request) do
    {:ok, file} = :file.open(part, [:write, :raw, :binary])
    result = pieces(file, request, "")
    :ok = :file.close(file)

    with {:ok, request} <- result, {:ok, _found} <- checked(part, request), :ok <- Raw.rename(part, path) do
      {:ok, request}
    else
      {:error, _status, _words, _request} = error ->
        _ = Raw.rm(part)
        error

      {:error, reason} ->
        _ = Raw.rm(part)
        {:error, 500, "#{:file.format_error(reason)}", request}
    end
  end

  defp checked(part, request) do
    with :ok <- Raw.chmod(part, 0o600), {:ok, found} <- Pmtiles.look(part) do
      {:ok, found}
    else
      {:error, reason} when is_atom(reason) -> {:error, reason}
      {:error, words} -> {:error, 422, words, request}
    end
  end

  # Another kind of file is refused by its first bytes, not after gigabytes.
  defp pieces(file, request, start) do
    {more, bytes, request} = :cowboy_req.read_body(request, @piece)

    start =
      if byte_size(start) < 16,
        do: binary_part(start <> bytes, 0, min(16, byte_size(start <> bytes))),
        else: start

    cond do
      match?(<<"SQLite format 3", _::binary>>, start) ->
        {:error, 422,
         "it is an MBTiles file; pmtiles convert FILE.mbtiles FILE.pmtiles makes one that can be used",
         request}

      byte_size(start) >= 7 and not match?(<<"PMTiles", _::binary>>, start) ->
        {:error, 422, "it is not a PMTiles file", request}

      more == :more and bytes == "" ->
        {:error, 408, "nothing came for #{div(@piece.period, 1_000)} s", request}

      true ->
        with :ok <- :file.write(file, bytes),
             do: if(more == :ok, do: {:ok, request}, else: pieces(file, request, start))
    end
  end
end
