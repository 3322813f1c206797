// 802.11ax, HE SU at 5 GHz. --what=airtime prints the air time of one PPDU with `mpdus` MPDUs of 1400 B of
// UDP (by ns-3's formula, no simulation): its preamble and header, and the whole. --what=saturation
// simulates one sender that keeps its queue full for one sink: best effort (EDCA, no TXOP limit), equal
// power, no noise errors; single MPDUs with normal ACK, or A-MPDUs with Block Ack.
// airtime prints width_mhz, streams, mcs, guard_interval_ns, payload_bytes, mpdus, psdu_bytes, preamble_us,
// air_us. saturation prints width_mhz, streams, mcs, guard_interval_ns, payload_bytes, ampdu_bytes,
// block_ack_frames, run, seconds, received payload in Mbit/s, PPDUs with data per second, MPDUs per such
// PPDU, their mean air time in us.
#include "network.h"

using namespace reference;

constexpr uint32_t MAC_OVERHEAD_BYTES = 8 + 26 + 4; // LLC/SNAP, QoS header, FCS

static double
Microseconds(Time time)
{
    return time.GetNanoSeconds() * 1e-3;
}

int
main(int argc, char* argv[])
{
    std::string what = "saturation";
    uint16_t widthMhz = 80;
    uint32_t streams = 1;
    uint32_t mcs = 0;
    uint32_t guardIntervalNs = 800;
    uint32_t payloadBytes = 1400;
    uint32_t mpdus = 1;
    uint32_t ampduBytes = 0;
    uint32_t blockAckFrames = 64;
    double seconds = 5.0;
    bool timeline = false;
    CommandLine command(__FILE__);
    command.AddValue("what", "airtime or saturation", what);
    command.AddValue("width", "channel width, MHz", widthMhz);
    command.AddValue("streams", "spatial streams", streams);
    command.AddValue("mcs", "MCS, 0 to 11", mcs);
    command.AddValue("gi", "guard interval, ns: 800, 1600 or 3200", guardIntervalNs);
    command.AddValue("payload", "UDP payload, B", payloadBytes);
    command.AddValue("mpdus", "MPDUs in the PPDU (airtime)", mpdus);
    command.AddValue("ampdu", "greatest A-MPDU, B; 0: single MPDUs (saturation)", ampduBytes);
    command.AddValue("window", "frames of the Block Ack window, 64 or 256 (saturation)", blockAckFrames);
    command.AddValue("seconds", "measured time (saturation)", seconds);
    command.AddValue("timeline", "print transmissions", timeline);
    command.Parse(argc, argv);

    const std::string mode = "HeMcs" + std::to_string(mcs);
    if (what == "airtime")
    {
        WifiTxVector vector;
        vector.SetMode(WifiMode(mode));
        vector.SetPreambleType(WIFI_PREAMBLE_HE_SU);
        vector.SetChannelWidth(widthMhz);
        vector.SetGuardInterval(guardIntervalNs);
        vector.SetNss(streams);
        vector.SetNTx(streams);
        vector.SetAggregation(mpdus > 1);
        // a single MPDU has a delimiter of 4 B as well, and no padding after it
        const uint32_t mpduBytes = payloadBytes + UDP_IP_BYTES + MAC_OVERHEAD_BYTES;
        const uint32_t paddedBytes = (mpduBytes + 3) / 4 * 4;
        const uint32_t psduBytes = (mpdus - 1) * (4 + paddedBytes) + 4 + mpduBytes;
        std::cout << widthMhz << "," << streams << "," << mcs << "," << guardIntervalNs << "," << payloadBytes
                  << "," << mpdus << "," << psduBytes << ","
                  << Microseconds(WifiPhy::CalculatePhyPreambleAndHeaderDuration(vector)) << ","
                  << Microseconds(WifiPhy::CalculateTxDuration(psduBytes, vector, WIFI_PHY_BAND_5GHZ))
                  << std::endl;
        return 0;
    }

    WifiSettings settings;
    settings.standard = WIFI_STANDARD_80211ax;
    settings.qos = true;
    settings.widthMhz = widthMhz;
    settings.dataMode = mode;
    settings.streams = streams;
    settings.guardIntervalNs = guardIntervalNs;
    settings.ampduBytes = ampduBytes;
    settings.blockAckFrames = blockAckFrames;
    NodeContainer nodes(2);
    auto devices = InstallWifi(settings, nodes, EqualPower(-40.0), Circle(2, 0.4));
    if (timeline)
    {
        PrintTransmissions(devices);
    }
    uint64_t data = 0;
    uint64_t frames = 0;
    Time air;
    auto phy = DynamicCast<WifiNetDevice>(devices.Get(0))->GetPhy();
    phy->TraceConnectWithoutContext("PhyTxPsduBegin",
                                    Callback<void, WifiConstPsduMap, WifiTxVector, double>(
                                        [&](WifiConstPsduMap psdus, WifiTxVector vector, double) {
                                            const auto psdu = psdus.begin()->second;
                                            if (psdu->GetHeader(0).IsData())
                                            {
                                                data++;
                                                frames += psdu->GetNMpdus();
                                                air += WifiPhy::CalculateTxDuration(psdu,
                                                                                    vector,
                                                                                    phy->GetPhyBand());
                                            }
                                        }));
    Sink sink(devices.Get(1));
    SaturatedSender sender(devices.Get(0), devices.Get(1)->GetAddress(), payloadBytes, 3 * blockAckFrames);
    Simulator::Schedule(Seconds(1), [&] {
        sink.Reset();
        data = frames = 0;
        air = Time();
    });
    Simulator::Stop(Seconds(1 + seconds));
    Simulator::Run();
    std::cout << widthMhz << "," << streams << "," << mcs << "," << guardIntervalNs << ","
              << payloadBytes << "," << ampduBytes << "," << blockAckFrames << ","
              << RngSeedManager::GetRun() << "," << seconds << ","
              << sink.PayloadMbps(payloadBytes, seconds) << "," << data / seconds << ","
              << double(frames) / data << "," << Microseconds(air) / data << std::endl;
    Simulator::Destroy();
}
