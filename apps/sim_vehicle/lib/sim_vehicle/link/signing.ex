defmodule SimVehicle.Link.Signing do
  @moduledoc """
  Signed links as in ArduPilot. While disarmed it accepts SETUP_SIGNING from every accepted sender. From then on it signs
  everything and requires signatures, except for RADIO_STATUS and RADIO; a key and a timestamp of zeros end this. On a link
  that counts as USB it also accepts unsigned and wrongly signed frames. The key survives a reboot.

  Its signing clock does not run: GPS sets it once, then it advances by one with each sent frame, and to the timestamp of each
  valid received frame. It is stored every 30 s. After a reboot it starts a minute after the stored value.

  PX4 (1.18) does the same, but accepts unsigned heartbeats from everybody.
  """

  import MavCodec.MessageId

  alias MavCodec.Frame
  alias MavCodec.Messages.SetupSigning

  # Message ids that need no signature (S7).
  @unsigned %{ardupilot: [id(RadioStatus), id(Radio)], px4: [id(Heartbeat), id(RadioStatus)]}

  @store_us 30_000_000
  @after_boot 6_000_000

  @enforce_keys [:secure]
  defstruct [:secure, :state, :key, firmware: :ardupilot, stored: 0, stored_at: 0]

  @type t :: %__MODULE__{
          secure: boolean,
          state: MavCodec.Signing.t() | nil,
          key: binary | nil,
          firmware: :ardupilot | :px4,
          stored: non_neg_integer,
          stored_at: integer
        }

  @doc "Starts with a key or none, and with a signing clock at a timestamp (nil: GPS time); `secure`: the link counts as USB."
  @spec new(binary | nil, boolean, :ardupilot | :px4, MavCodec.Signing.timestamp() | nil) :: t
  def new(key, secure, firmware \\ :ardupilot, at \\ nil) do
    signing = %__MODULE__{secure: secure, firmware: firmware}
    if key, do: with_key(signing, key, at || gps()), else: signing
  end

  defp gps, do: MavCodec.Signing.timestamp(MavCodec.Signing.new(<<0::256>>))

  defp with_key(signing, key, at) do
    options = [stored: at, accept_unsigned: Map.fetch!(@unsigned, signing.firmware)]
    options = if signing.firmware == :ardupilot, do: [clock: fn -> 0 end] ++ options, else: options
    %{signing | state: MavCodec.Signing.new(key, options), key: key, stored: at}
  end

  @doc "The vehicle's time is now `us`; stores the signing clock when that is due."
  @spec tick(t, integer) :: t
  def tick(%{state: state, stored_at: at} = signing, us) when state != nil and us - at >= @store_us,
    do: %{signing | stored: MavCodec.Signing.timestamp(state), stored_at: us}

  def tick(signing, _us), do: signing

  @doc "After a reboot the signing clock starts from the stored value, and all streams are forgotten."
  @spec rebooted(t) :: t
  def rebooted(%{state: nil} = signing), do: signing

  def rebooted(%{key: key, stored: stored} = signing),
    do: with_key(%{signing | stored_at: 0}, key, stored + @after_boot)

  @doc "The frame of a message as it is sent."
  @spec sign(t, binary, struct, module) :: {binary, t}
  def sign(%{state: nil} = signing, bytes, _message, _dialect), do: {bytes, signing}
  def sign(signing, <<0xFE, _::binary>> = bytes, _message, _dialect), do: {bytes, signing}

  def sign(signing, bytes, %module{}, dialect) do
    {_id, extra, _base, _extended} = dialect.layout(module)
    {bytes, state} = MavCodec.Signing.sign(signing.state, bytes, extra)
    {bytes, %{signing | state: state}}
  end

  @doc "Whether a frame is accepted."
  @spec check(t, Frame.t()) :: {:ok | :refused, t}
  def check(%{state: nil} = signing, _frame), do: {:ok, signing}

  def check(signing, frame) do
    case MavCodec.Signing.check(signing.state, frame) do
      {{:rejected, _why}, state} -> {if(signing.secure, do: :ok, else: :refused), %{signing | state: state}}
      {_right, state} -> {:ok, %{signing | state: state}}
    end
  end

  @doc "Handles SETUP_SIGNING, whatever its target."
  @spec setup(t, SetupSigning.t(), map) :: t
  def setup(%{firmware: :ardupilot} = signing, _setup, %{armed: true}), do: signing

  def setup(signing, %{target_system: system} = setup, %{system: system}) do
    case setup do
      %{secret_key: <<0::256>>, initial_timestamp: 0} -> %{signing | state: nil}
      %{secret_key: key, initial_timestamp: at} -> with_key(signing, key, at)
    end
  end

  def setup(signing, _for_another, _vehicle), do: signing
end
