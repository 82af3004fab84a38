defmodule MavCodec.Generated.Messages.Part3 do
  use MavCodec.Definition.Shard, messages: {3, 8}
end
