defmodule SimVehicle.Server.Options do
  @moduledoc """
  The options of one simulated vehicle, checked once.
  """

  alias SimVehicle.{Link, Params}
  alias SimVehicle.Firmware.{Ardupilot, Ardurover, Px4}

  @personalities %{ardupilot: Ardupilot, ardurover: Ardurover, px4: Px4}
  @ready_s %{ardupilot: 41.4, ardurover: 41.4, px4: 4.0}

  @spec_table [
    firmware: {:ardupilot, "`:ardupilot` (a copter), `:ardurover` or `:px4`"},
    link: {"udpout:127.0.0.1:14550", "an address as in `SimVehicle.Link`"},
    system: {1, "MAVLink system id, 1..255"},
    component: {1, "component id, 1..255"},
    home:
      {{-35.363261, 149.165230, 584.0}, "`{latitude, longitude, metres above the sea}` of the place of start"},
    heading: {353.0, "degrees, 0..360"},
    ready_s: {nil, "seconds after boot until the position is good; nil = as the firmware's simulator"},
    speed: {1.0, "vehicle seconds in a second of real time, 0.1..100"},
    wind: {0.0, "gusts, standard deviation in m/s, 0..10"},
    seed: {1, "integer from which all chance of this vehicle is drawn"},
    battery: {[], "keyword: `capacity_mah`, `cells`"},
    rates: {%{}, "messages a second by message id, over the firmware's own"},
    params: {%{}, "values by parameter name, over the firmware's own"},
    more_params: {[], "`{name, value, MAV_PARAM_TYPE}` of parameters after the firmware's own"},
    files: {%{}, "files by path, which MAVLink FTP serves"},
    logs: {[], "contents of the logs on board"},
    camera:
      {nil,
       "nil, or the component id of a camera with parameters of its own, 2..255 (`SimVehicle.Vehicle.Camera`)"},
    mavlink:
      {2, "protocol version that is spoken, 1, 2, or :both: frames in turn, what 1 does not have in 2"},
    key: {nil, "nil, or the 32 bytes of the signing key that it has from the start"},
    signed_at: {nil, "nil (GPS time), or the time stamp that the clock of its signatures begins with"},
    secure:
      {false,
       "whether its link counts as USB does for ArduPilot: unsigned frames are taken there, key or not"},
    script: {nil, "nil, or the script that the vehicle flies by itself (`SimVehicle.Pilot`)"},
    name: {nil, "a name for the process as GenServer takes it, or nil"}
  ]

  @doc "All options with their defaults and what they mean."
  @spec table() :: keyword({term, String.t()})
  def table, do: @spec_table

  @doc "Checks options and completes them; the error names the key, what was expected and what was given."
  @spec validate(keyword) :: {:ok, map} | {:error, String.t()}
  def validate(opts) do
    with :ok <- known(opts) do
      defaults = Map.new(@spec_table, fn {key, {default, _meaning}} -> {key, default} end)
      opts = Map.merge(defaults, Map.new(opts))

      case Enum.find(@spec_table, fn {key, _spec} -> not valid?(key, opts[key], opts) end) do
        nil ->
          {:ok, complete(opts)}

        {key, {_default, meaning}} ->
          {:error, "expected :#{key} to be #{meaning}, got: #{inspect(opts[key])}"}
      end
    end
  end

  @doc "The same, or an ArgumentError."
  @spec validate!(keyword) :: map
  def validate!(opts) do
    case validate(opts) do
      {:ok, opts} -> opts
      {:error, text} -> raise ArgumentError, text
    end
  end

  defp known(opts) do
    case Enum.find(Keyword.keys(opts), &(not Keyword.has_key?(@spec_table, &1))) do
      nil ->
        :ok

      key ->
        {:error,
         "unknown option :#{key}#{hint(key)}; known: #{Enum.map_join(@spec_table, ", ", &":#{elem(&1, 0)}")}"}
    end
  end

  defp hint(key) do
    {likeness, nearest} =
      @spec_table |> Keyword.keys() |> Enum.map(&{String.jaro_distance("#{key}", "#{&1}"), &1}) |> Enum.max()

    if likeness > 0.75, do: ", did you mean :#{nearest}?", else: ""
  end

  defp valid?(:firmware, value, _opts), do: is_map_key(@personalities, value)
  defp valid?(:link, value, _opts), do: match?({:ok, _parsed}, Link.parse(value))
  defp valid?(key, value, _opts) when key in [:system, :component], do: is_integer(value) and value in 1..255

  defp valid?(:camera, value, opts),
    do: value == nil or (is_integer(value) and value in 2..255 and value != opts.component)

  defp valid?(:home, {lat, lon, alt}, _opts),
    do: is_number(lat) and abs(lat) <= 90 and is_number(lon) and abs(lon) <= 180 and is_number(alt)

  defp valid?(:home, _other, _opts), do: false
  defp valid?(:heading, value, _opts), do: is_number(value) and value >= 0 and value <= 360
  defp valid?(:ready_s, value, _opts), do: value == nil or (is_number(value) and value >= 0)
  defp valid?(:speed, value, _opts), do: is_number(value) and value >= 0.1 and value <= 100
  defp valid?(:wind, value, _opts), do: is_number(value) and value >= 0 and value <= 10
  defp valid?(:seed, value, _opts), do: is_integer(value)
  defp valid?(:mavlink, value, _opts), do: value in [1, 2, :both]

  defp valid?(:battery, value, _opts) do
    Keyword.keyword?(value) and
      Enum.all?(value, fn {key, n} -> key in [:capacity_mah, :cells] and is_number(n) and n > 0 end)
  end

  defp valid?(:rates, value, _opts) do
    is_map(value) and
      Enum.all?(value, fn {id, hz} -> is_integer(id) and id >= 0 and is_number(hz) and hz >= 0 end)
  end

  defp valid?(:params, value, opts) do
    is_map(value) and
      Enum.all?(value, fn {name, number} ->
        is_number(number) and Params.member?(@personalities[opts.firmware].params(), name)
      end)
  end

  defp valid?(:more_params, value, _opts) do
    is_list(value) and
      Enum.all?(value, fn {name, number, type} ->
        is_binary(name) and byte_size(name) in 1..16 and is_number(number) and type in [2, 4, 6, 9]
      end)
  end

  defp valid?(:files, value, _opts),
    do: is_map(value) and Enum.all?(value, fn {path, bytes} -> is_binary(path) and is_binary(bytes) end)

  defp valid?(:logs, value, _opts), do: is_list(value) and Enum.all?(value, &is_binary/1)
  defp valid?(:key, value, _opts), do: value == nil or (is_binary(value) and byte_size(value) == 32)
  defp valid?(:signed_at, value, _opts), do: value == nil or (is_integer(value) and value >= 0)
  defp valid?(:secure, value, _opts), do: is_boolean(value)
  defp valid?(:script, value, _opts), do: value == nil or SimVehicle.Pilot.script?(value)
  defp valid?(:name, _value, _opts), do: true

  defp complete(opts) do
    {lat, lon, alt} = opts.home
    {:ok, address} = Link.parse(opts.link)

    Map.merge(opts, %{
      personality: Map.fetch!(@personalities, opts.firmware),
      home: %{lat: round(lat * 1.0e7), lon: round(lon * 1.0e7), alt: alt * 1.0},
      ready_s: opts.ready_s || Map.fetch!(@ready_s, opts.firmware),
      address: address
    })
  end
end
