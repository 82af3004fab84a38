defmodule Aerie.Api.Settings.Map do
  @moduledoc "What the console's map stands on: `console.map`."

  import Aerie.Base.Settings.Field, only: [field: 3, field: 4]
  import Aerie.Base.Settings.Rules

  alias Aerie.Base.Net.Address
  alias Aerie.Base.Settings.{Field, Schema}

  @most_layers 20

  @doc "The keys."
  @spec fields() :: [Field.t()]
  def fields do
    [
      field(
        :openstreetmap,
        :boolean,
        """
        Whether the gateway may fetch the map of OpenStreetMap for its pages. Left out, the empty map asks an admin
        once; false:
        nobody is asked, and nothing is fetched.
        """,
        example: "true"
      ),
      field(
        :layers,
        {:list, {:section, layer_fields()}},
        """
        Maps of your own, from files of this machine or from servers. The gateway fetches and keeps the tiles; pages
        load nothing from
        elsewhere. The map offers each of them, at first the first one.
        """,
        default: [],
        example:
          ~S|[{id: field, file: "/srv/maps/field.pmtiles", attribution: "(c) OpenStreetMap contributors"}]|
      ),
      field(
        :dir,
        :path,
        "Folder of fetched tiles, which can be deleted any time, of uploaded map files, and of what admins decided.",
        default: "var/map"
      ),
      field(:cache_mb, {:integer, 10, 100_000}, "Fetched tiles on the disk; beyond that the oldest ones go.",
        default: 500
      ),
      field(:upload_mb, {:integer, 1, 100_000}, "The largest map file that an admin may upload.",
        default: 4_096
      )
    ]
  end

  defp layer_fields do
    [
      field(:id, Aerie.Base.Settings.Types.token(), "Its name in addresses.", required: true),
      field(:name, {:text, 1, 40}, "Its name for people. Left out: the id."),
      field(
        :kind,
        {:enum, [:raster, :vector]},
        "What a server's tiles are: images or vectors (MVT).",
        default: :raster
      ),
      field(:url, {:parse, &url/1, "a URL such as https://tiles.example.org/{z}/{x}/{y}.png"}, """
      Address of a server's tiles, with {z}, {x} and {y}, and {key} where the content of key_file belongs.
      """),
      field(
        :file,
        :file,
        "A PMTiles file, or a folder of Z/X/Y.png, .jpg, .webp or .pbf, in place of a URL."
      ),
      field(
        :key_file,
        :file,
        "File with the key of the server's owner; only the gateway's user may be able to read it."
      ),
      field(:attribution, {:text, 1, 200}, "What the map says about the source, as its licence asks for."),
      field(:min_zoom, {:integer, 0, 24}, "Zoom below which the server has nothing.", default: 0),
      field(:max_zoom, {:integer, 0, 24}, "Zoom beyond which it has nothing.", default: 19)
    ]
  end

  @doc false
  @spec url(String.t()) :: {:ok, String.t()} | :error
  def url(text) do
    with true <- byte_size(text) <= 500 and text =~ ~r/\A[!-~]+\z/,
         true <- Enum.all?(~w({z} {x} {y}), &String.contains?(text, &1)),
         {:ok, %URI{scheme: scheme, host: host, userinfo: nil, fragment: nil}}
         when scheme in ["http", "https"] and is_binary(host) and host != "" <-
           text |> String.replace(["{", "}"], "") |> URI.new() do
      {:ok, text}
    else
      _other -> :error
    end
  end

  @doc "What is wrong with the keys together."
  @spec problems(map()) :: [Schema.problem()]
  def problems(%{layers: layers}) do
    path = ["console", "map", "layers"]

    alone =
      for {layer, n} <- Enum.with_index(layers),
          found <-
            failed([
              {layer.url == nil == (layer.file == nil), path ++ [n], "either url or file",
               if(layer.url, do: "both", else: "neither")},
              {layer.key_file != nil != keyed?(layer), path ++ [n], "{key} in the url and key_file together",
               "one of them in #{Address.shown(layer.url || "a file")}"},
              {layer.min_zoom > layer.max_zoom, path ++ [n, "max_zoom"], "min_zoom or more",
               "#{layer.max_zoom}"},
              {layer.id == "osm", path ++ [n, "id"],
               "another name: osm is OpenStreetMap (console.map.openstreetmap)", "osm"}
            ]),
          do: found

    few =
      failed([{length(layers) > @most_layers, path, "at most #{@most_layers} layers", "#{length(layers)}"}])

    few ++ alone ++ twice(layers, & &1.id, path, "each id once")
  end

  defp keyed?(%{url: url}), do: url != nil and String.contains?(url, "{key}")
end
