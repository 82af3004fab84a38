defmodule Aerie.Api.Rest.Recordings do
  @moduledoc "Shows and controls recordings for `/api`."

  alias Aerie.Base.Json
  alias MavRouter.Recorder
  alias Aerie.Access.HTTP.Error

  @modes %{"always" => :always, "armed" => :armed, "off" => :off}
  @max_reason 40

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
  def one(nil), do: nil

  def one(recording) do
    %{
      state: recording.state,
      mode: mode(recording.mode),
      reason: recording.reason,
      file: recording.file && Path.basename(recording.file),
      size: recording.size,
      since: recording.since && Json.time(recording.since * 1_000_000),
      frames: recording.frames,
      bytes: recording.bytes,
      dropped: recording.dropped,
      error: error(recording.error)
    }
  end

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

  @doc "Saves the last minutes of a vehicle; `%{\"reason\" => text}` becomes part of the file's name."
  @spec save(term(), String.t(), map()) :: {:ok, map()} | {:error, Error.t() | Aerie.Base.Error.t()}
  def save(gateway, vehicle, object) do
    with {:ok, reason} <- reason(Map.get(object, "reason", "request")),
         {:ok, file} <- Recorder.save(gateway, vehicle, reason) do
      name = Path.basename(file)
      {:ok, %{name: name, url: "/api/recordings/#{name}"}}
    end
  end

  defp reason(text) do
    if Json.text?(text, 0, @max_reason),
      do: {:ok, text},
      else: Error.invalid("reason must be a text of at most #{@max_reason} characters")
  end

  @doc "Starts or stops the recording of `{:vehicle | :link, name}`: `%{\"mode\" => \"always\" | \"armed\" | \"off\"}`."
  @spec record(term(), {:vehicle | :link, String.t()}, map()) ::
          {:ok, map()} | {:error, Error.t() | Aerie.Base.Error.t()}
  def record(gateway, target, object) do
    with {:ok, mode} <- wanted(object["mode"]),
         :ok <- change(gateway, target, mode),
         do: {:ok, %{recording: one(Recorder.status(gateway, target))}}
  end

  defp wanted(mode) when is_map_key(@modes, mode), do: {:ok, @modes[mode]}
  defp wanted(_other), do: Error.invalid("mode must be always, armed or off")

  defp change(gateway, target, :off), do: Recorder.stop(gateway, target)
  defp change(gateway, target, mode), do: Recorder.start(gateway, target, mode)

  defp named(%{target: {kind, _id}, label: label}), do: %{kind: kind, label: label}

  defp mode({:until, _at}), do: :saving
  defp mode(mode), do: mode

  defp error(nil), do: nil
  defp error(error), do: %{time: Json.time(error.at * 1_000_000), reason: error.reason}
end
