defmodule Aerie.Recorder.Settings do
  @moduledoc """
  What the configuration says about recording (section `recorder`), in bytes and milliseconds. Missing keys have defaults,
  so that a test can give a plain map with the few keys that it is about.
  """

  @mega 1024 * 1024

  defstruct dir: "var/recordings",
            links: :off,
            vehicles: :off,
            sent: true,
            max_file: 64 * @mega,
            max_file_ms: 3_600_000,
            max_total: 2048 * @mega,
            min_free: 512 * @mega,
            queue: 4 * @mega,
            after_ms: 30_000,
            fsync: :interval,
            flush_ms: 500,
            pause_ms: 5000,
            space_ms: 10_000,
            ring: true,
            ring_ms: 120_000,
            ring_bytes: 8 * @mega,
            ring_total: 128 * @mega,
            save_on: [],
            files: Aerie.Recorder.Files

  @typedoc """
  - `dir`: folder of the recordings
  - `links`, `vehicles`: what is recorded by itself: `:off`, `:armed` (while a vehicle on it is), `:always`
  - `sent`: also what is sent to vehicles
  - `max_file`, `max_file_ms`: size and age at which a file is followed by the next
  - `max_total`, `min_free`: our files together; what is to stay free on the disk
  - `queue`: bytes that may wait for the disk, for each recording
  - `after_ms`: for how long a recording goes on after disarming, or after what it was saved for
  - `fsync`: `:always` (after each write), `:interval` (once a second), `:never`
  - `flush_ms`: for how long records are collected; `pause_ms`: after a fault of the disk; `space_ms`: between two looks
    at its free space
  - `ring…`: the last moments of each vehicle, in memory; `save_on`: event types on which they are saved
  - `files`: the module that does what is done with files (`Aerie.Recorder.Files`)
  """
  @type t :: %__MODULE__{}

  @doc "From a configuration, or any map with some of its keys."
  @spec new(map | nil) :: t
  def new(%{recorder: %{} = section}) do
    ring = Map.get(section, :ring) || %{}

    Enum.reduce(
      [
        {:dir, section[:dir]},
        {:links, section[:links]},
        {:vehicles, section[:vehicles]},
        {:sent, section[:sent]},
        {:max_file, bytes(section[:max_file_mb])},
        {:max_file_ms, ms(section[:max_file_minutes], 60)},
        {:max_total, bytes(section[:max_mb])},
        {:min_free, bytes(section[:min_free_mb])},
        {:queue, kilo(section[:queue_kb])},
        {:after_ms, ms(section[:after_s], 1)},
        {:fsync, section[:fsync]},
        {:flush_ms, section[:flush_ms]},
        {:pause_ms, section[:pause_ms]},
        {:space_ms, section[:space_ms]},
        {:files, section[:files]},
        {:ring, ring[:enabled]},
        {:ring_ms, ms(ring[:seconds], 1)},
        {:ring_bytes, kilo(ring[:max_kb])},
        {:ring_total, bytes(ring[:total_mb])},
        {:save_on, ring[:save_on] && Enum.map(ring[:save_on], &to_string/1)}
      ],
      %__MODULE__{},
      fn
        {_key, nil}, settings -> settings
        {key, value}, settings -> Map.replace!(settings, key, value)
      end
    )
  end

  def new(_none), do: %__MODULE__{}

  defp bytes(nil), do: nil
  defp bytes(mega), do: round(mega * @mega)
  defp kilo(nil), do: nil
  defp kilo(kilo), do: round(kilo * 1024)
  defp ms(nil, _unit), do: nil
  defp ms(n, seconds), do: round(n * seconds * 1000)
end
