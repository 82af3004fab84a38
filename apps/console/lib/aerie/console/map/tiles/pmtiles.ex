defmodule Aerie.Console.Map.Tiles.Pmtiles do
  @moduledoc """
  The header of a PMTiles file (version 3, 127 bytes): enough to tell a file that pages can read from one that was cut
  off, or is something else. Pages read the rest.
  """

  @header 127
  # Type 1 is vectors, the others are images.
  @kinds %{1 => "vector", 2 => "raster", 3 => "raster", 4 => "raster", 5 => "raster"}

  @type t :: %{kind: String.t(), min_zoom: 0..30, max_zoom: 0..30, bytes: pos_integer()}

  @doc "Looks at a file."
  @spec look(Path.t()) :: {:ok, t()} | {:error, String.t()}
  def look(path) do
    with {:ok, %File.Stat{type: :regular, size: size}} <- File.stat(path),
         {:ok, bytes} when is_binary(bytes) <- File.open(path, [:read, :binary, :raw], &read/1) do
      header(bytes, size)
    else
      {:error, reason} -> {:error, "#{:file.format_error(reason)}"}
      _empty_or_no_file -> {:error, "it is not a PMTiles file"}
    end
  end

  defp read(file) do
    with {:ok, bytes} <- :file.read(file, @header), do: bytes
  end

  defp header(
         <<"PMTiles", 3, root_at::little-64, root::little-64, meta_at::little-64, meta::little-64,
           leaves_at::little-64, leaves::little-64, data_at::little-64, data::little-64, _counts::192,
           _clustered, _inside, _packed, kind, low, high, _rest::binary>> = bytes,
         size
       )
       when byte_size(bytes) == @header do
    last =
      Enum.max(
        for {at, length} <- [{root_at, root}, {meta_at, meta}, {leaves_at, leaves}, {data_at, data}],
            do: at + length
      )

    cond do
      last > size -> {:error, "it is cut off: #{size} of #{last} bytes"}
      root == 0 or root_at < @header -> {:error, "its directory is missing"}
      low > high or high > 30 -> {:error, "its zooms are #{low} to #{high}"}
      not is_map_key(@kinds, kind) -> {:error, "its tiles are of an unknown type (#{kind})"}
      true -> {:ok, %{kind: @kinds[kind], min_zoom: low, max_zoom: high, bytes: size}}
    end
  end

  defp header(<<"PMTiles", 3, _short::binary>>, size), do: {:error, "it is cut off after #{size} bytes"}

  defp header(<<"PMTiles", version, _::binary>>, _size),
    do: {:error, "it is PMTiles version #{version}; only version 3 is supported"}

  defp header(_other, _size), do: {:error, "it is not a PMTiles file"}
end
