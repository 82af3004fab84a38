defmodule Aerie.RecorderCase do
  @moduledoc "Tests of recordings: a gateway's parts with a recorder, frames at chosen times, disks that fail."
  use ExUnit.CaseTemplate

  alias MavCodec.{Frame, Parser, Tlog}

  using do
    quote do
      import Aerie.LinkCase
      import Aerie.RecorderCase
    end
  end

  @doc "Starts the parts of a gateway whose recorder writes into a folder; `recorder` are keys of that section."
  @spec start_recorder(Path.t(), map) :: reference
  def start_recorder(dir, recorder \\ %{}) do
    section =
      Map.merge(%{dir: Path.join(dir, "recordings"), min_free_mb: 0, flush_ms: 5, space_ms: 60_000}, recorder)

    Aerie.LinkCase.start_parts(%{recorder: section}, before: [{MavRouter.Recorder.Supervisor, []}])
  end

  @doc "The frame of bytes that came at a time."
  @spec frame(binary, integer) :: Frame.t()
  def frame(bytes, at) do
    {[frame], _parser} = Parser.push_datagram(Parser.new(), bytes, at)
    frame
  end

  @doc "A heartbeat of a copter, armed or not, at a time."
  @spec beat(non_neg_integer, boolean, integer) :: Frame.t()
  def beat(system, armed, at) do
    %MavCodec.Messages.Heartbeat{
      type: 2,
      autopilot: 3,
      base_mode: if(armed, do: 0x81, else: 1),
      mavlink_version: 3
    }
    |> MavCodec.encode(system: system, component: 1)
    |> frame(at)
  end

  @doc "Numbered frames from a time on, a millisecond apart."
  @spec attitudes(non_neg_integer, Range.t(), integer) :: [Frame.t()]
  def attitudes(system, numbers, from \\ 1_000_000_000_000_000),
    do: for(n <- numbers, do: frame(Aerie.LinkCase.attitude(system, n), from + n * 1000))

  @doc "The frames of a recording."
  @spec recorded(Path.t()) :: [Frame.t()]
  def recorded(path), do: path |> Tlog.Reader.frames!() |> Enum.to_list()

  @doc "The files in a folder that look like recordings."
  @spec tlogs(Path.t()) :: [Path.t()]
  def tlogs(dir), do: [dir, "recordings", "*.tlog"] |> Path.join() |> Path.wildcard() |> Enum.sort()

  defmodule FullDisk do
    @moduledoc "Writes go to /dev/full, where the system itself says that the disk is full."
    @behaviour MavRouter.Recorder.Files
    alias MavRouter.Recorder.Files

    @impl Files
    defdelegate create(path), to: Files
    @impl Files
    def open(_path), do: :file.open(~c"/dev/full", [:write, :raw, :binary])
    @impl Files
    defdelegate write(device, bytes), to: Files
    @impl Files
    def sync(_device), do: :ok
    @impl Files
    defdelegate close(device), to: Files
    @impl Files
    def free(_dir), do: :unknown
  end

  defmodule FaultyDisk do
    @moduledoc """
    A disk whose state is a public table: `full` (writes fail after half of what was given), `free` (bytes), and a gate that
    writes wait at while it is closed.
    """
    @behaviour MavRouter.Recorder.Files
    alias MavRouter.Recorder.Files

    @doc "A disk for the folder of a test; `set/3` changes it."
    @spec new(Path.t()) :: :ok
    def new(dir) do
      :ets.insert(table(), [{{dir, :full}, false}, {{dir, :free}, :unknown}, {{dir, :gate}, nil}])
      :ok
    end

    @spec set(Path.t(), atom, term) :: true
    def set(dir, what, value), do: :ets.insert(table(), {{dir, what}, value})

    defp get(path, what), do: :ets.lookup_element(table(), {root(path), what}, 2)

    # …/recordings/file or …/recordings
    defp root(path) do
      path = to_string(path)

      if Path.basename(path) == "recordings",
        do: Path.dirname(path),
        else: path |> Path.dirname() |> Path.dirname()
    end

    # Owned by a process that lives as long as the tests do.
    defp table do
      case :persistent_term.get(__MODULE__, nil) do
        nil -> make()
        table -> table
      end
    end

    defp make do
      :global.trans({__MODULE__, self()}, fn ->
        case :persistent_term.get(__MODULE__, nil) do
          nil ->
            owner = self()

            spawn(fn ->
              send(owner, {:table, :ets.new(:disks, [:public])})
              receive(do: (:never -> :ok))
            end)

            receive do
              {:table, table} -> :persistent_term.put(__MODULE__, table)
            end

            :persistent_term.get(__MODULE__)

          table ->
            table
        end
      end)
    end

    @impl Files
    def create(path), do: if(get(path, :full), do: {:error, :enospc}, else: Files.create(path))

    @impl Files
    def open(path) do
      with {:ok, device} <- Files.open(path), do: {:ok, {path, device}}
    end

    @impl Files
    def write({path, device}, bytes) do
      with test when is_pid(test) <- get(path, :gate) do
        send(test, {:at_the_gate, self()})
        receive(do: (:pass -> :ok))
      end

      if get(path, :full) do
        bytes = IO.iodata_to_binary(bytes)
        :ok = Files.write(device, binary_part(bytes, 0, div(byte_size(bytes), 2)))
        {:error, :enospc}
      else
        Files.write(device, bytes)
      end
    end

    @impl Files
    def sync({_path, device}), do: Files.sync(device)
    @impl Files
    def close({_path, device}), do: Files.close(device)

    @impl Files
    def free(dir) do
      case get(dir, :free) do
        :unknown -> :unknown
        bytes -> {:ok, bytes}
      end
    end
  end
end
