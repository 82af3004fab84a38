defmodule MavRouter.Recorder.Archive.Name do
  @moduledoc """
  Names of recordings: `main-radio-1-20261121T013005Z.tlog`, from the network, the link or vehicle, and the UTC of the start; a second one
  in the same second is `…Z-2.tlog`. Characters of a label that do not belong in a file name become `_`.
  """

  @max 100
  @ours ~r/\A[A-Za-z0-9][A-Za-z0-9._-]*-\d{8}T\d{6}Z(-\d{1,3})?\.tlog\z/

  @doc "The name without its extension, for a label and a time in unix seconds."
  @spec new(String.t(), integer) :: String.t()
  def new(label, at) do
    utc = at |> DateTime.from_unix!() |> Calendar.strftime("%Y%m%dT%H%M%SZ")
    label(label) <> "-" <> utc
  end

  @doc "A label as the names of its files begin."
  @spec label(String.t()) :: String.t()
  def label(label) do
    cleaned = label |> String.slice(0, @max) |> String.replace(~r/[^A-Za-z0-9._-]+/, "_")
    if cleaned =~ ~r/\A[A-Za-z0-9]/, do: cleaned, else: "x" <> cleaned
  end

  @doc "The one of these networks with which a name begins, nil for a name of somebody else; `main-2` before `main`."
  @spec network(String.t(), [String.t()]) :: String.t() | nil
  def network(name, networks) do
    networks
    |> Enum.sort_by(&{-byte_size(&1), &1})
    |> Enum.find(&String.starts_with?(name, label(&1) <> "-"))
  end

  @doc "The file name at the n-th attempt to find a free one."
  @spec attempt(String.t(), pos_integer) :: String.t()
  def attempt(name, 1), do: name <> ".tlog"
  def attempt(name, n), do: "#{name}-#{n}.tlog"

  @doc "Whether a line of the index can be a name from here."
  @spec ours?(String.t()) :: boolean
  def ours?(name), do: name =~ @ours
end
