defmodule Aerie.Api.Rest.View.Recordings do
  @moduledoc "Recordings as `/api` shows them."

  alias Aerie.Base.Json
  alias Aerie.Base.Json.Object
  alias MavRouter.Recorder

  @doc "A summary of the recorder, or nil."
  @spec status(term()) :: map() | nil
  def status(gateway) do
    with %{recordings: recordings, space: space} = status <- Recorder.status(gateway) do
      last =
        recordings |> Enum.map(& &1.error) |> Enum.reject(&is_nil/1) |> Enum.max_by(& &1.at, fn -> nil end)

      %{
        dir: status.dir,
        free_bytes: if(is_map(space) and is_integer(space.free), do: space.free),
        low: if(space, do: space.low, else: false),
        recording: Enum.count(recordings, &(&1.state == :recording)),
        paused: Enum.count(recordings, &(&1.state == :paused)),
        dropped: recordings |> Enum.map(& &1.dropped) |> Enum.sum(),
        error: error(last)
      }
    end
  end

  @doc "The recording of a link's or vehicle's snapshot, or nil."
  @spec one(map() | nil) :: map() | nil
  def one(recording), do: recording && Object.show(Recorder.fields(), recording)

  @doc "The whole state of the recorder: active recordings, content of the rings, files."
  @spec all(term()) :: map() | nil
  def all(gateway) do
    with %{recordings: recordings, rings: rings} <- Recorder.status(gateway) do
      Map.merge(status(gateway), %{
        recordings: for(recording <- recordings, do: Map.merge(one(recording), named(recording))),
        rings:
          for(
            {{network, system}, ring} <- Enum.sort(rings),
            do: %{network: network, system: system, bytes: ring.bytes, entries: ring.entries}
          ),
        files: Enum.map(Recorder.list(gateway), &file/1)
      })
    end
  end

  @doc "A file as `all/1` lists it."
  @spec file(map()) :: map()
  def file(file) do
    %{
      name: Path.basename(file.file),
      bytes: file.bytes,
      time: Json.time(file.at * 1_000_000),
      open: file.open
    }
  end

  @doc "A recording by its file name, as `{:file, path, bytes}`; nil for any other name."
  @spec download(term(), String.t()) :: {:file, Path.t(), non_neg_integer()} | nil
  def download(gateway, name) do
    with %{file: path, bytes: bytes} <- Recorder.find(gateway, name), do: {:file, path, bytes}
  end

  defp named(%{target: {kind, _id}, label: label}), do: %{kind: kind, label: label}

  defp error(nil), do: nil
  defp error(error), do: %{time: Json.time(error.at * 1_000_000), reason: error.reason}
end
