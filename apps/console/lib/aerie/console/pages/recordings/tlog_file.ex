defmodule Aerie.Console.Pages.Recordings.TlogFile do
  @moduledoc "What a recording's name and its first bytes say: what was recorded, and since when."

  @name ~r/\A(.+)-\d{8}T\d{6}Z(?:-\d{1,3})?\.tlog\z/
  # A stamp from before 2000 is from a machine that did not know the time.
  @plausible_us 946_684_800_000_000..4_102_444_800_000_000

  @doc "The vehicle or link that was recorded: `main-radio` of `main-radio-20261121T013005Z.tlog`."
  @spec label(String.t()) :: String.t()
  def label(name), do: Regex.replace(@name, name, "\\1")

  @doc "When a recording begins (unix microseconds), by its first frame; nil if it cannot be read."
  @spec start(Path.t()) :: integer() | nil
  def start(path) do
    case File.open(path, [:read, :binary, :raw], &:file.read(&1, 8)) do
      {:ok, {:ok, <<us::64>>}} when us in @plausible_us -> us
      _unreadable -> nil
    end
  end

  @doc "A number of bytes in words."
  @spec size(non_neg_integer()) :: String.t()
  def size(bytes) when bytes < 10_000, do: "#{bytes} B"
  def size(bytes) when bytes < 10_000_000, do: "#{div(bytes, 1_000)} kB"
  def size(bytes) when bytes < 10_000_000_000, do: "#{div(bytes, 1_000_000)} MB"
  def size(bytes), do: "#{div(bytes, 1_000_000_000)} GB"
end
