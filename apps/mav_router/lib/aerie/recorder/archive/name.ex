defmodule Aerie.Recorder.Archive.Name do
  @moduledoc """
  Names of recordings: `main-radio-1-20261121T013005Z.tlog`, of the network, the link or vehicle, and the UTC of its
  beginning; a second one of that second is `…Z-2.tlog`. Whatever a label has that a file name should not have becomes `_`.
  """

  @max 100
  @ours ~r/\A[A-Za-z0-9][A-Za-z0-9._-]*-\d{8}T\d{6}Z(-\d{1,3})?\.tlog\z/

  @doc "The name without its ending, for a label and a time in unix seconds."
  @spec new(String.t(), integer) :: String.t()
  def new(label, at) do
    utc = at |> DateTime.from_unix!() |> Calendar.strftime("%Y%m%dT%H%M%SZ")
    clean(label) <> "-" <> utc
  end

  defp clean(label) do
    cleaned = label |> String.slice(0, @max) |> String.replace(~r/[^A-Za-z0-9._-]+/, "_")
    if cleaned =~ ~r/\A[A-Za-z0-9]/, do: cleaned, else: "x" <> cleaned
  end

  @doc "The file's name at the n-th attempt to find one that is free."
  @spec attempt(String.t(), pos_integer) :: String.t()
  def attempt(name, 1), do: name <> ".tlog"
  def attempt(name, n), do: "#{name}-#{n}.tlog"

  @doc "Whether a line of the index can be a name that was given here."
  @spec ours?(String.t()) :: boolean
  def ours?(name), do: name =~ @ours
end
