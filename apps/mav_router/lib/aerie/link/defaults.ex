defmodule Aerie.Link.Defaults do
  @moduledoc """
  What the configuration says about every link, and a link's own options may change (`Aerie.Link.Spec`, `options`):
  `:max_peers`, `:idle_ms` (no frame for so long: idle), `:parser` (options of `MavCodec.Parser.new/1`),
  `:serial_ports` and `:serial_bauds` (where a search begins, `Aerie.Link.Serial.Detector`).

  Kept as the value of the links' supervisor's name, so that links that are added at run time have them too.
  """

  alias Aerie.Names

  @dialects %{
    all: MavCodec.Dialects.All,
    upstream: MavCodec.Dialects.Upstream,
    ardupilot: MavCodec.Dialects.Ardupilot,
    common: MavCodec.Dialects.Common
  }

  @doc "Reads a configuration, or any map with some of its keys."
  @spec from(map | nil) :: keyword
  def from(config) do
    config = config || %{}
    [max_peers: max_peers(config), idle_ms: idle_ms(config), parser: parser(config)] ++ serial(config)
  end

  defp serial(%{serial: %{ports: ports, bauds: bauds}}), do: [serial_ports: ports, serial_bauds: bauds]
  defp serial(_none), do: []

  defp max_peers(%{limits: %{max_peers: max}}), do: max
  defp max_peers(_none), do: 256

  defp idle_ms(%{timeouts: %{link_idle_s: seconds}}), do: round(seconds * 1000)
  defp idle_ms(_none), do: 10_000

  defp parser(%{mavlink: %{dialects: names, sysid32: long}}) do
    [dialects: Enum.map(names, &Map.fetch!(@dialects, &1)), sysid32: long]
  end

  defp parser(_none), do: []

  @doc "Keeps them; the calling process is the links' supervisor."
  @spec put(Names.gateway(), keyword) :: :ok
  def put(gateway, defaults), do: Names.put_value(gateway, :links, defaults)

  @doc "Those of a gateway."
  @spec get(Names.gateway()) :: keyword
  def get(gateway), do: Names.value(gateway, :links) || from(nil)
end
