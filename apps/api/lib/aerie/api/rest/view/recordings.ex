defmodule Aerie.Api.Rest.View.Recordings do
  @moduledoc "Recordings as `/api` shows them."

  alias Aerie.Base.Json.Object
  alias MavRouter.Recorder

  @status Object.fields([
            {:dir, :text, nil, "the folder of the recordings"},
            {:free_bytes, :integer, "B", "what is free there"},
            {:low, :boolean, nil, "whether that is too little to record"},
            {:recording, :integer, nil, "how many recordings are being written"},
            {:paused, :integer, nil, "how many are paused"},
            {:dropped, :integer, nil, "frames that could not be written"},
            {:error, {:object, Recorder.error_fields()}, nil, "the last fault of the disk"}
          ])
  @recording Recorder.fields() ++
               Object.fields([
                 {:kind, {:one_of, [:link, :vehicle, :saved]}, nil, "what is recorded"},
                 {:label, :text, nil, "its name"}
               ])
  @ring Object.fields([
          {:network, :text, nil, "network of the vehicle"},
          {:system, :integer, nil, "its system id"},
          {:bytes, :integer, "B", "how much is kept of it", [:ring, :bytes]},
          {:entries, :integer, nil, "how many frames are kept of it", [:ring, :entries]}
        ])
  @file_fields Object.fields([
                 {:name, :text, nil, "its name", &__MODULE__.file_name/1},
                 {:bytes, :integer, "B", "its size"},
                 {:time, {:time, :second}, nil, "when it was written last", :at},
                 {:open, :boolean, nil, "whether it is being written"}
               ])
  @fields @status ++
            Object.fields([
              {:recordings, {:list, {:object, @recording}}, nil, "of links and vehicles"},
              {:rings, {:list, {:object, @ring}}, nil, "the last minutes of vehicles"},
              {:files, {:list, {:object, @file_fields}}, nil, "the recordings on disk"}
            ])

  @doc "The fields of `status/1`."
  @spec status_fields() :: [Object.t()]
  def status_fields, do: @status

  @doc "The fields of `all/1`."
  @spec fields() :: [Object.t()]
  def fields, do: @fields

  @doc "A summary of the recorder, or nil."
  @spec status(term()) :: map() | nil
  def status(gateway), do: with(%{} = status <- summary(gateway), do: Object.show(@status, status))

  defp summary(gateway) do
    with %{recordings: recordings, space: space} = status <- Recorder.status(gateway) do
      Map.merge(status, %{
        free_bytes: if(is_map(space) and is_integer(space.free), do: space.free),
        low: if(space, do: space.low, else: false),
        recording: Enum.count(recordings, &(&1.state == :recording)),
        paused: Enum.count(recordings, &(&1.state == :paused)),
        dropped: recordings |> Enum.map(& &1.dropped) |> Enum.sum(),
        error:
          recordings |> Enum.map(& &1.error) |> Enum.reject(&is_nil/1) |> Enum.max_by(& &1.at, fn -> nil end)
      })
    end
  end

  @doc "The whole state of the recorder: active recordings, content of the rings, files."
  @spec all(term()) :: map() | nil
  def all(gateway) do
    with %{recordings: recordings, rings: rings} = summary <- summary(gateway) do
      rings =
        for {{network, system}, ring} <- Enum.sort(rings), do: %{ring: ring, network: network, system: system}

      recordings = for %{target: {kind, _id}} = recording <- recordings, do: Map.put(recording, :kind, kind)

      Object.show(
        @fields,
        %{summary | recordings: recordings, rings: rings} |> Map.put(:files, Recorder.list(gateway))
      )
    end
  end

  @doc false
  @spec file_name(map()) :: String.t()
  def file_name(%{file: file}), do: Path.basename(file)

  @doc "A recording by its file name, as `{:file, path, bytes}`; nil for any other name."
  @spec download(term(), String.t()) :: {:file, Path.t(), non_neg_integer()} | nil
  def download(gateway, name) do
    if file = Recorder.find(gateway, name), do: {:file, file.file, file.bytes}
  end
end
